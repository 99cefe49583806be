"""Light as waves: from the field on the object to the photoelectrons of a frame.

object_samples.py      the object as samples that propagate
illumination.py        phase screen on the virtual source -> field on the hidden object
motion.py              sub-exposures of a moving spot or object
detector_roughness.py  subjective speckle of the virtual detector
other_light.py         stray light: clutter and multiple reflections
camera.py              the intensity that pixels collect: pupil and pixel
"""
