"""Whether frames show speckle that travels: a moving object, or a moving camera, with the laser at rest.

Frames whose laser spot was moved have independent speckle. What they share is static light, and a moving camera shifts that. If they
share the speckle itself, then most of its power appears in the cross-correlation of consecutive frames. An object with the part p of the
light has the part p^2 of this power; the interference of several objects, which has the rest, may change from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from correlograph.errors import InputError
from correlograph.files.capture import Capture
from invert.tracking.band import Band
from invert.tracking.central_lobe import central_lobe
from invert.tracking.light import at_even_power, light_of_frames
from invert.tracking.parts import on_all_cores
from invert.tracking.pursuit import find_objects
from invert.tracking.shares import Shares
from invert.tracking.shifts import heights_at, weight_of
from invert.tracking.spectra import DIM_FRAMES_FOR_POWER, FRAMES_FOR_POWER, Reader, frames_in_memory
from invert.tracking.start import Start, find_brightest
from radiometry.autocorrelation import PatchGrid
from radiometry.estimation.third_moment import narrow

MIN_SHARE = 0.6
"""Share of the light, squared, above which its common speckle counts as speckle that travels; the rest could be static light."""

MIN_RATIO = 6.0
"""Highest cross-correlation of consecutive frames over its rms from which travel is sought; the highest of 10^5 shifts of frames that
share nothing lies below it with a probability of 0.9999."""


@dataclass(frozen=True)
class Travel:
    """Mean displacement of the speckle from frame to frame in pixels, of each object (k, 2), and the share of the light, squared, that
    consecutive frames have in common at these displacements; for one object, it is the share of the power of its speckle.
    """

    steps_pixels: np.ndarray
    share: float

    def describe(self) -> str:
        """Return a note for a result."""
        ways = ", and by ".join(f"{rows:.1f} rows and {columns:.1f} columns" for rows, columns in self.steps_pixels)
        return (
            f"the speckle travels by about {ways} from frame to frame, as if the object moved and the laser did not; python -m "
            "invert.track shows the path"
        )


def quick_spectra(frames: Sequence[np.ndarray], grid: PatchGrid) -> list[torch.Tensor]:
    """Return the spectra of frames, binned by two, at the lags of a grid."""
    reader, patch = Reader((frames[0].shape[0], frames[0].shape[1]), 2), (grid.patch_shape[0] // 2, grid.patch_shape[1] // 2)
    return on_all_cores(lambda frame: narrow(torch.from_numpy(reader.whole(frame)), reader.shape, patch, grid.lags), frames)


def may_travel(spectra: Sequence[torch.Tensor]) -> bool:
    """Return whether frames have a pattern in common, at any shift, from their spectra at the lags (`narrow`)."""
    if len(spectra) < 2:
        return False
    cross = torch.stack([one.conj() * other for one, other in pairwise(spectra)]).sum(0)
    cross[0, 0] = 0.0
    rows, columns = cross.shape
    found = torch.fft.irfft2(cross, s=(rows, 2 * columns - 1))
    return float(found.max() / found.square().mean().sqrt().clamp_min(1e-30)) > MIN_RATIO


def common_share(frames: Sequence[np.ndarray]) -> float:
    """Return the share of the power of the speckle that consecutive frames have in common, unless it may be static light: less than
    `MIN_SHARE`, and at rest."""
    if (read := _read_first(frames)) is None:
        return 0.0
    spectra, band = read
    try:
        found = find_brightest(spectra, band)
    except InputError:
        return 0.0
    steps = np.linalg.norm(np.diff(found.path, axis=0), axis=1)
    return found.share if found.share > MIN_SHARE or np.median(steps) > band.grain_pixels else 0.0


def _read_first(frames: Sequence[np.ndarray], count: int = FRAMES_FOR_POWER) -> tuple[np.ndarray, Band] | None:
    """Return the spectra of the first frames, at even power, and their band; of a larger number of frames if they are dim. None for a
    single frame, or if they show no speckle."""
    reader = Reader(frames[0].shape, 1)
    band = reader.band(frames)
    if band is None or len(frames) < 2:
        return None
    first = frames[: max(FRAMES_FOR_POWER, min(count, frames_in_memory(band))) if band.is_dim else FRAMES_FOR_POWER]
    return at_even_power(reader.all_spectra(first, band), band), band


def find_travel(capture: Capture) -> Travel | None:
    """Return how the speckle of a capture travels; None if consecutive frames have less than `MIN_SHARE` in common, or if it is
    never farther than a grain from its start."""
    if (read := _read_first(capture.frames, DIM_FRAMES_FOR_POWER)) is None:
        return None
    spectra, band = read
    try:
        found = find_objects(spectra, band)
    except InputError:
        return None
    if 3 * found[0].jumps > len(spectra) - 1:  # it shakes
        return None
    central = central_lobe(band) if len(found) > 1 else band
    shares = Shares(spectra, central, light_of_frames(spectra, central))
    by_each = [shares.along(one.path, 1) for one in found]
    powers = np.linalg.solve(_overlap(found, central) + 1e-3 * np.eye(len(found)), by_each) * central.power / band.power
    share = float(np.sqrt(powers.clip(0.0)).sum() ** 2)
    steps = np.array([one.path[-1] / (len(spectra) - 1) for one in found])
    far = max(float(np.linalg.norm(one.path, axis=1).max()) for one in found)
    way = max(far, float(np.linalg.norm(steps, axis=1).max()) * (len(capture.frames) - 1))
    return Travel(steps, share) if share > MIN_SHARE and way > band.grain_pixels else None


def _overlap(found: Sequence[Start], band: Band) -> np.ndarray:
    """Return the height of the maximum of each object's cross-correlation of consecutive frames at the place of each other, (k, k)."""
    steps, weight = np.array([one.path[-1] / (len(one.path) - 1) for one in found]), weight_of(band, 0.0)
    apart = (steps[:, None] - steps[None]).reshape(-1, 2)
    own = np.broadcast_to(band.signal.astype(np.complex64), (len(apart), *band.signal.shape))
    return (heights_at(own, band, weight, apart) / weight.full).reshape(len(found), len(found))
