"""Noise of the autocorrelation estimate.

model.py   S = H (r*r) + b, Gamma and Gaussian: draws and likelihood
level.py   floor, degrees of freedom and signal read from an estimate
budget.py  what the floor is made of; degrees of freedom; error of an estimate
"""
