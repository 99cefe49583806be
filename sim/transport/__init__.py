"""Light as rays and powers: what reaches the frame, and what the virtual detector sees.

surfaces.py          which surfaces can be modelled; light that passes between two places
light_transport.py   light from laser to pixel by way of a point of a surface
hidden_object.py     the object seen from the virtual detector, on any grid (object_grid.py: its rays and cells)
flat_object.py       albedo cells in its place
footprint.py         what a camera at any angle sees of the wall, and which lags it resolves
monte_carlo.py      Monte Carlo light budget, and the light that comes by other ways
path_ends.py         laser, camera and shapes to aim at, as its paths need them
detector_texture.py  the wall's own albedo under each pixel
ambient.py           light of other emitters
"""
