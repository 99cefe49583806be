"""Propagation from the hidden object to the virtual detector, one kernel a file.

sampling.py     scatterers, wall, and the kernel that all of these compute or approximate
fraunhofer.py   one FFT; exact in the far field, statistically exact for a flat rough object
fresnel.py      exact phases at the frame's centre, then one FFT
nufft.py        scatterers in space to patches of the wall, to a tolerance
direct.py       the whole sum
validity.py     predicted errors
choose.py       the cheapest within a tolerance
"""
