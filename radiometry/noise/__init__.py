"""Noise of the autocorrelation estimate.

model.py            S = H (r*r) + b with Gamma or Gaussian noise: sampling and likelihood
measured_noise.py   noise floor, degrees of freedom and largest lag with signal, measured from an estimate
detection.py        significance of the signal above the floor
predicted_floor.py  contributions to the noise floor of a scene; error of an estimate
"""
