"""Autocorrelation estimates from frames.

whole_frames.py     all pairs of pixels, and the mean that the frames show
published.py        the paper's, patches side by side
illumination.py     a smooth illumination, found and divided out
fixed_pattern.py    patterns that frames share, a camera that moved
spectral_lines.py   fringes, lamp banding and other periodic light
pixel_faults.py     hot pixels, dead and hot lines, saturation
third_moment.py     whether the light is speckle of an object
"""
