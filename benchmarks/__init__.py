"""Timings, each a ratio against a named reference of the same run. They gate nothing.

    hio.py   HIO of 16 starts against the FFTs that it cannot do without
"""
