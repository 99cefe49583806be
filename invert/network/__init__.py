"""The network at run time.

features.py     input features of an estimate
blocks.py       residual blocks, attention, U-net
model.py        denoiser, sketch and fusion
paper_unet.py   the paper's network, the baseline
overview.py     what the fusion is shown of classical retrieval
sampler.py      removes noise from pictures of the object
annealing.py    samples of the posterior
fisher_scoring.py   steps towards the data
inference.py    from a measurement to a reconstruction
confidence.py   what the reconstruction's confidence is made of
checkpoints.py  weights on disk
"""
