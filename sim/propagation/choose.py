"""Which kernel propagates: the cheapest whose predicted error stays below the tolerance."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from radiometry.errors import InputError
from sim.propagation import direct, nufft, validity
from sim.propagation.sampling import Scatterers, Wall

FFT_SECONDS_PER_PIXEL = 2e-8
DIRECT_SECONDS = 0.004
NUFFT_PLANNING_SECONDS = 0.5
NUFFT_SECONDS = (0.003, 0.017, 3e-7, 2.5e-8)
"""Once; of a patch; per term and scatterer of a patch; per term and pixel. On two cores, to rank kernels by."""


@dataclass(frozen=True)
class Option:
    """One kernel in one precision, with its predicted error, seconds and bytes for a frame; `why` where it cannot be had.

    `patches` are those of nufft.
    """

    propagator: str
    precision: str
    predicted_error: float
    seconds: float
    bytes: int
    why: str
    patches: nufft.Patches | None = None

    def as_dict(self) -> dict[str, Any]:
        return {name: None if isinstance(value, float) and not math.isfinite(value) else value
                for name, value in asdict(self).items() if name != "patches"}


def options(wall: Wall, place: np.ndarray, scatterers: Scatterers, lag_m: float | tuple[float, float], accuracy: str,
            tolerance: float, precision: str | None, *, wanted: str | None = None) -> list[Option]:
    """Kernels for a scene, cheapest first.

    Args:
        place, lag_m: see `validity.py`.
        wanted: a kernel's name for that one only; `auto` for those among which the choice lies, because predicting the
            dearer ones takes longer than using a cheap one; None for all.
    """
    pixels = math.prod(wall.shape)
    found = []
    statistical = validity.statistical_error(wall, place, scatterers, lag_m) if accuracy == "statistical" else 0.0
    for name in ("fraunhofer", "fresnel"):
        if precision == "float64" or wanted not in (None, "auto", name):
            continue
        error = statistical
        if accuracy == "field":
            error = validity.UNRELATED if name == "fraunhofer" else validity.fresnel_error(wall, place, scatterers)
        why = "flat, delta-correlated object in the far field" if name == "fraunhofer" else "exact phases at the frame's centre"
        cost = FFT_SECONDS_PER_PIXEL * pixels * (1.0 if name == "fraunhofer" else 1.5)
        found.append(Option(name, "float32", error, cost, 16 * pixels, why))
        if wanted == "auto" and error <= tolerance:
            return found
    kinds = [kind for kind in ("float32", "float64") if precision in (None, kind)]
    if wanted in (None, "auto", "direct"):
        found += [_direct(wall, scatterers, kind) for kind in kinds]
    quick = any(option.predicted_error <= tolerance and option.seconds < NUFFT_PLANNING_SECONDS for option in found)
    if wanted in (None, "nufft") or (wanted == "auto" and not quick):
        holding = [kind for kind in kinds if wanted != "auto" or 0.5 * tolerance >= nufft.TOLERANCE[kind][0]]
        found += [_nufft(wall, scatterers, kind, tolerance) for kind in holding or kinds[-1:]]
    return sorted(found, key=lambda option: option.seconds)


def _nufft(wall: Wall, scatterers: Scatterers, precision: str, tolerance: float) -> Option:
    low, high = nufft.TOLERANCE[precision]
    try:
        patches = nufft.plan_patches(scatterers.position_m, wall, min(max(0.5 * tolerance, low), high), precision)
    except InputError:
        return Option("nufft", precision, math.inf, math.inf, 0, "the sum of products does not converge this close")
    size, terms = patches.size, patches.terms
    count = math.ceil(wall.shape[0] / size) * math.ceil(wall.shape[1] / size)
    once, each, scatterer, pixel = NUFFT_SECONDS
    seconds = once + count * (each + terms * (scatterer * len(scatterers) + pixel * size**2))
    memory = 16 * terms * (size**2 * 5 + 2 * len(scatterers)) + 16 * math.prod(wall.shape)
    return Option("nufft", precision, patches.error, seconds, memory,
                  f"{terms} terms in each of {count} patches of {size} pixels", patches)


def _direct(wall: Wall, scatterers: Scatterers, precision: str) -> Option:
    tiles = math.prod(math.ceil(pixels / direct.TILE) for pixels in wall.shape)
    seconds = DIRECT_SECONDS + tiles * direct.TILE**2 * len(scatterers) / direct.PAIRS_PER_SECOND[precision]
    return Option("direct", precision, validity.direct_error(wall, scatterers, precision, direct.TILE), seconds,
                  8 * math.prod(wall.shape) + 2**28, "every scatterer to every pixel")


def choose(listed: list[Option], propagator: str, tolerance: float) -> Option:
    """The cheapest option within the tolerance, or the forced propagator's most fitting one.

    Raises InputError where none (or not the forced one) can be had at all.
    """
    if propagator != "auto":
        listed = [option for option in listed if option.propagator == propagator and math.isfinite(option.seconds)]
        if not listed:
            raise InputError("--propagator", "one that the scene and --precision allow", propagator, "use auto or direct")
    within = [option for option in listed if option.predicted_error <= tolerance]
    if not within and propagator == "auto":
        best = min(option.predicted_error for option in listed)
        raise InputError("--tolerance", f"{best:.2g} or more", tolerance, "raise it or leave --precision out")
    return within[0] if within else min(listed, key=lambda option: option.predicted_error)
