"""Motion of hidden objects from the travel of their speckle over the wall, with the laser at rest.

band.py      frequencies at which frames show speckle
spectra.py   spectra of frames in this band
central_lobe.py  those of the speckle of objects, without their interference
shifts.py    displacements from cross-spectra, with standard errors
shares.py    share of the speckle that frames have in common along a path
parts.py     work on spectra in parts, on all cores
light.py     frames of uneven light
maxima.py    maxima of cross-correlations that belong to an object each
start.py     objects and their approximate paths
likely_path.py  most likely path where pairs of frames are dim
likelihood.py  likelihood that the patterns of some objects are all that frames show
fading.py    likelihood of patterns that fade
climb.py     paths at its maximum
interference.py  interference of objects, and the maximum of the likelihood with it
explained.py what paths explain of the light that frames have in common
several.py   several objects, by the likelihood of their paths together
pursuit.py   all objects of a capture
register.py  frames registered to those around them
numbers.py   numbers and order of frames, by the names of their files
smoothing.py paths without noise
follow.py    exact path of a single object, frame by frame
strange.py   frames that show something else
shutter.py   steps that an open shutter shortens
boundaries.py  likeness of the frames on both sides of a boundary
breaks.py    jumps of a path, and paths across them
components.py  power and fading of each of several objects
joint.py     exact paths of several objects together
drawn.py     their errors by interference that overlaps with them
normal_equations.py  score and information of these paths
vibration.py periodic motion in a path
to_object.py displacements of the object from those of its speckle
track.py     Track: a path, and what follows from it
tracker.py   the whole: frames -> Track
rings.py     turn and scale of autocorrelations
rotation.py  rotation and distance: frames -> Rotation
tables.py    checks and files that both share
travel.py    whether frames show speckle that travels
stabilise.py frames that follow an object
alone.py     r*r of one object among several
"""
