"""The most likely path against drawn evidence, and in frames that show no motion in pairs."""

from dataclasses import replace

import numpy as np
import pytest

from invert.tracking.band import Band
from invert.tracking.likely_path import _go_on, most_likely_path, refine_dim_path
from invert.tracking.start import Start


def band_of(side=(40, 52), signal=1.0, floor=1.0):
    rows, columns = np.fft.fftfreq(side[0])[np.r_[-5:6]], np.fft.rfftfreq(side[1])[:7]
    counts = np.where(columns > 0.0, 2.0, 1.0) * np.ones((11, 7))
    counts[5, 0] = 0.0
    falls = np.exp(-0.5 * ((rows[:, None] / 0.08) ** 2 + (columns / 0.06) ** 2))
    return Band(side, rows, columns, counts, signal * falls, floor, floor * np.ones((11, 7)))


def spectra_along(path, band, rng):
    """Return spectra (frames, R, C) of one pattern along a path, in noise."""
    shape = band.signal.shape

    def drawn():
        return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)

    own = np.sqrt(band.signal) * drawn()
    turns = [np.exp(-2j * np.pi * (band.rows[:, None] * row + band.columns * column)) for row, column in path]
    return np.array([own * turn + np.sqrt(band.floor) * drawn() for turn in turns]).astype(np.complex64)


def test_each_displacement_is_reached_from_the_best_one_beside_it(rng):
    total = rng.normal(size=(7, 9)).astype(np.float32)
    change = np.log(np.array([0.2, 0.5, 0.3]))
    found, way = _go_on(total, change)
    for row, column in np.ndindex(*total.shape):
        beside = {
            (i, j): total[(row + i) % 7, (column + j) % 9] + change[i + 1] + change[j + 1]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        }
        best = max(beside, key=lambda key: beside[key])
        assert found[row, column] == pytest.approx(beside[best], abs=1e-5)
        assert (way[row, column] // 3 - 1, way[row, column] % 3 - 1) == best


def test_a_path_with_sharp_turns_is_found_in_noise(rng):
    """Pairs of frames show a displacement at 2.4 standard deviations; after each ten steps, the object takes another velocity."""
    steps = np.repeat([(1.5, -2.5), (-3.0, 1.0), (0.0, 4.0), (2.0, 2.0), (-1.0, -3.0)], 10, axis=0)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
    band = band_of(signal=0.6)
    found = most_likely_path(spectra_along(path, band, rng), band)
    assert np.median(np.abs(np.diff(found, axis=0) - steps)) < 0.7
    assert (np.abs(np.diff(found, axis=0) - steps).max(1) < 2.5).mean() > 0.85


def test_a_step_without_evidence_is_interpolated(rng):
    """Nothing is in common across the middle: no displacement there lasts."""
    band = band_of(signal=2.0)
    one, other = (spectra_along(np.arange(12)[:, None] * np.array([1.0, -2.0]), band, rng) for _ in range(2))
    found = most_likely_path(np.concatenate([one, other]), band)
    np.testing.assert_allclose(np.diff(found, axis=0), np.tile([1.0, -2.0], (23, 1)), atol=1.5)


def test_only_a_path_along_which_frames_share_more_replaces_another(rng):
    band = band_of(signal=0.6)
    steps = np.repeat([(1.5, -2.5), (-3.0, 1.0), (0.0, 4.0), (2.0, 2.0)], 16, axis=0)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
    dim, noise = spectra_along(path, band, rng), spectra_along(path, band_of(signal=0.0), rng)
    wrong, right = (Start(one, 7.0, 0.3) for one in (np.zeros_like(path), path))
    found = refine_dim_path(dim, band, wrong)
    assert found.share > 0.6
    assert np.median(np.abs(np.diff(found.path, axis=0) - steps)) < 0.7
    assert refine_dim_path(dim, band, right) is right
    assert refine_dim_path(noise, band, wrong) is wrong
    few = replace(wrong, path=path[:8])
    assert refine_dim_path(dim[:8], band, few) is few


def test_a_grid_beyond_the_memory_gives_no_path(monkeypatch, rng):
    band = band_of()
    monkeypatch.setattr("invert.tracking.likely_path.MAX_POINTERS", 100)
    assert most_likely_path(spectra_along(np.zeros((9, 2)), band, rng), band) is None
