"""Films of moving objects: what the object looks like at each time.

looks.py     r*r of each frame on common lags, and their means over windows of time
windows.py   for how long the object stays the same, by the likelihood of held-out frames
turning.py   autocorrelations and albedos turned about their middle
fine.py      fields of the frames in each window
film.py      the film: albedos with times, and its files
video.py     the whole: frames -> Film
"""
