"""Captures given to the command: one, or many on workers."""
