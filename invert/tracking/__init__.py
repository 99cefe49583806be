"""Motion of a hidden object from the travel of its speckle over the wall, with the laser at rest.

shifts.py   displacement between two frames, from their weighted cross-correlation
track.py    path over all frames, with standard errors
travel.py   whether frames show speckle that travels
"""
