"""Propagation from the hidden object to the virtual detector, one propagator per file.

sampling.py     scatterers, wall, and the integral that all propagators compute or approximate
fraunhofer.py   one FFT; exact in the far field, statistically exact for a flat rough object
fresnel.py      exact phases at the frame centre, then one FFT
nufft.py        scatterers in space to patches of the wall, to a tolerance
direct.py       direct sum
validity.py     predicted errors
kernels.py      list of the propagators
choose.py       selection of the fastest within a tolerance
"""
