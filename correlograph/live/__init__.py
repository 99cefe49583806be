"""Live view: frames of a running camera, what they contain so far, and a local page that shows it.

sources.py   frames from a folder or file that grows, from a simulated scene, or from any object that yields frames
session.py   running estimate, measured values, reconstruction and saved frames
threads.py   threads that read, add and reconstruct
page.py      the page, for one browser on this machine
"""
