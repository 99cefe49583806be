"""The network at run time.

features.py           input features of an estimate
blocks.py             residual blocks, attention, U-net
model.py              denoiser, sketch, fusion
paper_unet.py         U-net of Metzler et al. 2020, the baseline
retrieval_summary.py  classical reconstructions as input of the fusion
sampler.py            diffusion posterior sampler
annealing.py          posterior sampling
inference.py          reconstruction by the network
despeckler.py         mean intensity of fields -> albedo
confidence.py         features and calibration of the confidence
checkpoints.py        weights files
"""
