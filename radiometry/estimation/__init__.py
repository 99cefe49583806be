"""Autocorrelation estimates from frames.

autocorrelation_estimator.py     estimator of all pixel pairs, with background models
published.py        estimator of Metzler et al. 2020: non-overlapping patches
background.py       record of background and sensor faults
illumination.py     smooth illumination: detection and correction
fixed_pattern.py    static background patterns, camera shift
spectral_lines.py   fringes, lamp flicker and other periodic light
hot_pixels.py       hot pixels, cosmic rays and specular highlights
pixel_faults.py     all faults of pixels, with defective rows and columns, and saturation
third_moment.py     third moment of the frames, which distinguishes speckle from texture
"""
