"""The network at run time.

    features.py     input features of an estimate
    blocks.py       residual blocks, attention, U-net
    model.py        denoiser, sketch and fusion
    paper_unet.py   the paper's network, the baseline
    proposals.py    what classical retrieval proposes to the fusion
    inference.py    from a measurement to a reconstruction
    confidence.py   what the reconstruction's confidence is made of
    checkpoints.py  weights on disk
"""
