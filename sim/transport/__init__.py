"""Light as rays and powers: the light that reaches the frame, and the object as seen from the virtual detector.

surfaces.py          surfaces that can be modelled; transmission between two points
light_transport.py   light from laser to pixel via one point of a surface
hidden_object.py     the object as seen from the virtual detector, on any grid (ray_grid.py: rays and cells)
flat_object.py       a flat object of albedo cells
footprint.py         footprint of a camera at any angle, and the lags that it resolves
monte_carlo.py       Monte Carlo light budget and stray light
path_ends.py         ends of its paths: laser, camera and target shapes
detector_texture.py  albedo of the virtual detector under each pixel
ambient.py           light of other emitters
"""
