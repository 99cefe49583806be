"""Propagation from the hidden object to the virtual detector, one propagator per file.

sampling.py     scatterers, wall, and the integral that all propagators compute or approximate
fraunhofer.py   one FFT; exact in the far field, statistically exact for a flat rough object
fresnel.py      one FFT; the phases of the scatterers are exact at the frame centre
nufft.py        non-uniform FFT from scatterers at any depth to patches of the wall, within a tolerance
direct.py       direct sum
validity.py     predicted errors
kernels.py      list of the propagators
choose.py       selection of the fastest within a tolerance
"""
