"""Lab estimates as series (lab_noise.py), and the figures that compare them with the noise model (figures.py)."""
