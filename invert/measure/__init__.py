"""Frames to a measurement: capture, estimate, noise level, Fourier modulus."""
