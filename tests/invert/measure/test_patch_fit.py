"""Patches that suit the object, on frames of an asymmetric letter of many sizes."""

import numpy as np
import pytest
import torch
from skimage.transform import resize

from correlograph.errors import InputError
from invert import reconstruct
from invert.albedo.registration import correlation_maps
from tests.light import speckle

SHAPE, AUTOMATIC = (2080, 2104), 260
FINE = 3
"""Cells of the truth in a lag of automatic patches."""


def letter(lags: float, cells_per_lag: float) -> np.ndarray:
    """An F, `lags` lags high, on a square of 128 lags."""
    row, column = np.mgrid[: 128 * cells_per_lag, : 128 * cells_per_lag] / (lags * cells_per_lag)
    stem, bars = column < 0.2, (row < 0.2) & (column < 0.7) | (row > 0.4) & (row < 0.6) & (column < 0.5)
    return ((row < 1.0) & (stem | bars)).astype(np.float64)


def frames(lags: float, seed: int = 5) -> np.ndarray:
    """Two frames, 0.3 photons a pixel; one pixel of the field is an eighth of a lag."""
    rng = np.random.default_rng(seed)
    steps = [np.arange(side) * AUTOMATIC / side for side in SHAPE]
    row, column = np.meshgrid(*(step[step < 128] for step in steps), indexing="ij")
    shown = letter(lags, 8)[(8 * row).astype(int), (8 * column).astype(int)]
    light = [speckle(shown, SHAPE, rng) for _ in range(2)]
    return rng.poisson(0.3 * np.stack(light)).astype(np.float32)


def likeness(result, lags: float) -> float:
    """Registered correlation with the truth, three cells to a lag of automatic patches, over a square of 128 such lags."""
    scale = AUTOMATIC / result.estimate.record.grid.size
    shown = resize(result.albedo, [round(64 * FINE * scale)] * 2, order=1)
    side = 128 * FINE
    shown = np.pad(shown, (0, max(side - len(shown), 0)))[:side, :side]
    maps = correlation_maps(torch.from_numpy(shown).float()[None], torch.from_numpy(letter(lags, FINE)).float())
    return float(maps.max())


@pytest.mark.slow
@pytest.mark.parametrize(("lags", "patch", "gain"), [(10, 520, 0.02), (90, (130, 150), 0.15)])
def test_small_objects_are_magnified_and_large_ones_held(lags, patch, gain):
    gains = []
    for seed in range(5, 11):  # single gains scatter by 0.05
        seen = frames(lags, seed)
        plain, fitted = reconstruct(seen, lags=63, quality="fast"), reconstruct(seen, patch="fit", quality="fast")
        size = fitted.estimate.record.grid.size
        assert size == patch if isinstance(patch, int) else patch[0] <= size <= patch[1]
        assert any("wider than the lags" in warning for warning in plain.warnings) == (lags > 64)
        assert not any("wider than the lags" in warning for warning in fitted.warnings)
        gains.append(likeness(fitted, lags) - likeness(plain, lags))
    assert np.mean(gains) > gain


@pytest.mark.slow
def test_patches_that_suit_the_object_are_left_alone():
    assert reconstruct(frames(36), patch="fit", quality="fast").estimate.record.grid.size == AUTOMATIC


@pytest.mark.parametrize("patch", ["large", 126, 129.0, True])
def test_other_patches_are_refused(rng, patch):
    with pytest.raises(InputError, match="patch: expected a"):
        reconstruct(rng.poisson(3.0, (1, 300, 300)), patch=patch, quality="fast")
