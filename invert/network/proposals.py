"""Classical reconstructions as network input: from all starts together, and from each start."""

from __future__ import annotations

import torch

from invert.registration import agreeing_mean, centred, consensus, normalised, registered
from invert.solvers.base import Candidates

COMPANIONS = 8
"""Starts, of least residual, with which every start is compared."""


def overview(found: Candidates) -> tuple[torch.Tensor, list[float]]:
    """Pictures (PICTURES, 64, 64) of all starts together, and how far they agree.

    Of the retrieval from the estimate and of that from its denoised signal (`found` holds both) the mean of the best starts,
    which is smooth where they differ, and the start of least residual, which is sharp; laid over the first.
    """
    pictures, agreement = [], []
    for images, residual in zip(found.images, found.residual, strict=True):
        together = consensus(images, residual)
        pictures += [together.image, images[residual.argmin()]]
        agreement.append(together.agreement)
    laid_over, _ = registered(torch.stack(pictures), pictures[0])
    return _in_window(laid_over), agreement


def proposals(found: Candidates, kinds: int) -> torch.Tensor:
    """The same for each start, (n, PICTURES, 64, 64): its mean with the best starts that agree with it, itself, and,
    of the best starts of the other retrieval, the mean of those that fit it about as well as any, and the best-fitting one.

    Starts cycle through `kinds` shrink-wrap thresholds and are compared within one, since a loose support leaves less residual.
    """
    alike = [Candidates(found.images[:, kind::kinds], found.residual[:, kind::kinds]) for kind in range(kinds)]
    return torch.stack([pictures for of_one_kind in alike for pictures in _of_each(of_one_kind)])


def _of_each(found: Candidates) -> list[torch.Tensor]:
    """Pictures (PICTURES, 64, 64) of every start, all compared with one another."""
    best = found.residual.argsort(dim=1, stable=True)[:, :COMPANIONS]
    proposed = []
    for own, images in enumerate(found.images):
        others = found.images[1 - own, best[1 - own]]
        for index, start in enumerate(images):
            siblings, likeness = registered(torch.cat((start[None], images[best[own][best[own] != index]])), start)
            cousins, fit = registered(others, start)
            here = [agreeing_mean(siblings, likeness), start]
            there = [agreeing_mean(cousins, fit), cousins[fit.argmax()]]
            proposed.append(_in_window(torch.stack(here + there if own == 0 else there + here)))
    return proposed


def _in_window(pictures: torch.Tensor) -> torch.Tensor:
    """The middle of pictures (n, 128, 128), taken together, largest value 1 each; zero or more."""
    return normalised(centred(pictures.clamp_min(0.0)))
