"""Noise of the autocorrelation estimate.

model.py   S = H (r*r) + b with Gamma or Gaussian noise: sampling and likelihood
level.py   noise floor, degrees of freedom and largest lag with signal, measured from an estimate
detection.py  significance of the signal above the floor
budget.py  contributions to the noise floor; error of an estimate
"""
