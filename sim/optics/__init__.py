"""Light as waves: from the field on the object to the photoelectrons of a frame.

object_samples.py      the object as samples that propagate
illumination.py        phase screen on the virtual source -> field on the hidden object
motion.py              sub-exposures of what moves
coherence.py           linewidth as an incoherent sum of lines
detector_roughness.py  the wall's own speckle through the pupil
other_light.py         clutter and interreflections as a background
camera.py              intensity -> electrons: pupil, pixel, noise
"""
