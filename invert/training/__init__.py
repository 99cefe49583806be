"""Training: the commands `invert.train`, `invert.warm_starts` and `invert.calibrate`.

train.py        the command: one run, from a dataset to weights
training_loop.py state of a run, checkpoints that resume exactly
data.py         noisy estimates of targets, sampled independently at every step
speckle.py      speckled fields of targets, for the despeckler
objectives.py   objective of each network part
denoising.py    denoising task of the sampler: noised truths
chains.py       denoising task of the sampler: its own trajectories
losses.py       losses of reconstructions and of the denoiser
warm_starts.py  precomputed classical reconstructions for the fusion
calibration.py  calibration of the confidence and of the credible intervals
report.py       learning curve of a run
"""
