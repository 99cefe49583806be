"""Classical phase retrieval, one method a file.

    base.py      what they share: projections, support, random starts, residual, `Candidates`
    registry.py  methods by name, and the qualities that trade their speed for accuracy

Every solver has the signature `solver(modulus, box, rng, options, progress) -> Candidates`, batched over images and starts.
"""
