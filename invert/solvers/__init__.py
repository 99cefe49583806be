"""Classical phase retrieval, one method per file.

    base.py      projections, support, random starts, residual, `Candidates`
    registry.py  solver and options of each method

Every solver has the signature `solver(modulus, box, rng, options, progress) -> Candidates`, batched over images and starts.
"""
