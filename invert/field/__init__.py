"""Fields: the complex field on the object, retrieved from each frame, and the fine albedo that their mean intensity shows.

    grid.py             grids of a frame and of the field on the object; the Fourier transform between them
    counts.py           frame -> photon counts, unmeasured and held-out pixels, background
    filtering.py        Wiener filter of the counts
    forward_model.py    expected counts of a field, and the derivative of their likelihood
    prior.py            expected intensity of the field: from the coarse albedo, then from the fields
    search.py           ADMM from a random field
    posterior.py        posterior of the field of a frame, and its gradient
    sampling.py         samples of the posterior (Langevin dynamics) and their means
    certificate.py      held-out pixels: whether a field predicts counts that it has not seen
    frame_retrieval.py  one frame: counts, search, sampling, certificate
    retrieval.py        all frames of a capture: passes, expectation maximisation, albedo
    despeckling.py      albedo from the intensities of several fields: by a network, or by total variation
    total_variation.py  total variation under the likelihood of the looks
    blending.py         blend with the coarse albedo at the scale of a lag
    reconstruction.py   fine albedo with resolution, standard deviation and certificate
    field.py            `Field`: intensity, refocusing, propagation to the wall

The coarse albedo of the pipeline is the prior; docs/fields.md derives the method and lists its limits.
"""
