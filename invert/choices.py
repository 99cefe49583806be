"""Methods and qualities: what a user can choose, defined once. This module imports neither torch nor a solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from correlograph.errors import InputError
from radiometry.estimation.background import MEAN_MODELS, MeanModel

T = TypeVar("T")


@dataclass(frozen=True, repr=False)
class Method:
    """A way to reconstruct an albedo from a measurement; `invert.methods` runs it.

    Attributes:
        weights: file of the trained network that it runs; None without a network.
    """

    name: str
    weights: Path | None = None

    def __repr__(self) -> str:
        return self.name


MAX_FIELD_PASSES = 4
"""Maximum number of passes over the frames after the first with any quality."""


@dataclass(frozen=True, repr=False)
class Quality:
    """A trade of time for accuracy.

    Attributes:
        solver_starts: random starts of a classical method.
        solver_iterations: fraction of a classical method's published number of iterations.
        network_starts: random starts of the phase retrieval that supplies images to the network, for the noisy and for the
            denoised modulus.
        augmentations: number of transformed copies of the input over which denoiser and fusion average.
        samples: posterior samples; 0 leaves the posterior sampler out.
        rounds: maximum number of times that noise is added to each posterior sample and removed again by the network, before a last
            time.
        converged: correlation of the mean reconstruction with that of one round less at which the rounds end; 1 for all rounds.
        finer_samples, finer_rounds: the same on grids of more than 64 lags, where sampling starts from the posterior samples
            of a coarser grid.
        field_steps: steps of the search of a field, as a fraction of those of `invert.field`.
        field_passes: maximum number of passes of `invert.field` over the frames after the first; each has the albedo of the one before
            as prior.
    """

    name: str
    solver_starts: int
    solver_iterations: float
    network_starts: int
    augmentations: int
    samples: int = 0
    rounds: int = 0
    converged: float = 1.0
    finer_samples: int = 1
    finer_rounds: int = 1
    field_steps: float = 1.0
    field_passes: int = MAX_FIELD_PASSES

    def __repr__(self) -> str:
        return self.name


DEFAULT_WEIGHTS = Path(__file__).parent / "weights" / "unet.safetensors"

UNET = Method("unet", DEFAULT_WEIGHTS)
FIELD = Method("field", DEFAULT_WEIGHTS)
CLASSICAL = Method("classical")
METHODS = {
    method.name: method
    for method in (UNET, FIELD, CLASSICAL, *map(Method, ("hio", "raar", "er", "altmin", "twf", "taf", "mtwf", "admm-tv")))
}

FAST = Quality("fast", 4, 0.3, network_starts=6, augmentations=1, field_steps=0.6, field_passes=1)
BALANCED = Quality(
    "balanced",
    16,
    1.0,
    network_starts=16,
    augmentations=4,
    samples=12,
    rounds=7,
    converged=0.9995,
    finer_samples=4,
    finer_rounds=4,
)
BEST = Quality("best", 64, 1.0, network_starts=32, augmentations=4, samples=32, rounds=11, finer_samples=8, finer_rounds=8)
QUALITIES = {quality.name: quality for quality in (FAST, BALANCED, BEST)}


def method_named(method: str | Method) -> Method:
    """Return the method of a name. Raises InputError for another name."""
    return method if isinstance(method, Method) else _entry("method", method, METHODS)


def quality_named(quality: str | Quality) -> Quality:
    """Return the quality of a name. Raises InputError for another name."""
    return quality if isinstance(quality, Quality) else _entry("quality", quality, QUALITIES)


def retrieves_fields(method: Method, quality: Quality) -> bool:
    """Return whether the field of each frame is retrieved, if there are frames: by `field`, and by `unet` with quality `best`."""
    return method == FIELD or (method, quality) == (UNET, BEST)


def check_mean_model(mean_model: str) -> MeanModel:
    """Return the name of a background model. Raises InputError for another name."""
    names: dict[str, MeanModel] = {name: name for name in MEAN_MODELS}
    return _entry("mean_model", mean_model, names)


def _entry(name: str, found: object, entries: Mapping[str, T]) -> T:
    if not isinstance(found, str) or found not in entries:
        raise InputError(name, f"one of {', '.join(entries)}", f"{found!r}", "select one of these")
    return entries[found]
