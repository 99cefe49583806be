"""The likelihood of an estimate as a function of the albedo.

forward_model.py     the mean S = a H (r*r) + c p + b of an estimate
gamma.py             the log-likelihood, its gradient and its Fisher information
data_consistency.py  steps up the likelihood from the images of a network
refinement.py        ascent of the likelihood, stopped early by cross-validation
"""
