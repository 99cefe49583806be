"""Propagation from the hidden object to the virtual detector, one kernel a file.

    fraunhofer.py   one FFT; exact in the far field, statistically exact for a flat rough object
"""
