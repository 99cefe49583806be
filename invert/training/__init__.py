"""Training: the commands `invert.train`, `invert.warm_starts` and `invert.calibrate`.

train.py        the command: one run, from a dataset to weights
training_run.py state of a run, checkpoints that resume exactly
data.py         noisy estimates of targets, drawn anew at every step
objectives.py   what each part is trained for
denoising.py    the sampler's task: truths behind noise
chains.py       the sampler's task: its own mistakes
losses.py       losses of reconstructions, and of the denoiser
warm_starts.py  classical reconstructions that the fusion is trained with
calibration.py  calibrates the network's confidence
report.py       the curve of a run
"""
