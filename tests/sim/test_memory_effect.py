"""The memory effect against closed forms: contrast, photons, decorrelation with angle, and r*r at its lags."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import sim
from radiometry.autocorrelation import autocorrelate
from radiometry.light_budget_rows import light_budget
from sim.memory_effect import MemoryEffect, autocovariance


@pytest.fixture(scope="module")
def letter() -> MemoryEffect:
    return MemoryEffect.of(sim.load("corner_letter").geometry)


@pytest.mark.slow
def test_light_and_contrast(letter, rng):
    budget = light_budget(sim.load("corner_letter").geometry.light_path)
    # The same solid angle through a smaller stop.
    through = (letter.aperture_m / 0.0514286) ** 2
    assert letter.photoelectrons_per_pixel_s * np.prod(letter.frame_shape) == pytest.approx(
        budget.photoelectrons_per_pixel_s * 2056 * 2464 * through, rel=0.03
    )
    bright = 1e7
    frames = [replace(letter, decorrelation=(0.0, 0.0)).frame(bright, rng) for _ in range(3)]
    mean = np.mean([frame.mean() for frame in frames])
    assert mean == pytest.approx(letter.photoelectrons_per_pixel_s * bright, rel=0.03)
    grains = [frame.std() / frame.mean() for frame in frames]
    # Neighbouring cells' grains overlap, which adds to the contrast of separate ones.
    assert 0.9 * letter.contrast < np.mean(grains) < 2.0 * letter.contrast


@pytest.mark.slow
def test_its_autocovariance_is_that_of_the_object(letter, rng):
    still = replace(letter, decorrelation=(0.0, 0.0))
    found = autocovariance([still.frame(1e7, rng) for _ in range(12)])
    known = autocorrelate(letter.cells)
    near = np.hypot(*np.mgrid[-63:64, -63:64]) < 25
    near[63, 63] = False
    assert np.corrcoef(found[near], known[near])[0, 1] > 0.85
    assert np.corrcoef(found[near], known.T[near])[0, 1] < np.corrcoef(found[near], known[near])[0, 1] - 0.1


def test_the_pattern_of_a_cell_fades_with_its_angle(letter, rng):
    """Two cells a far apart: their patterns correlate by exp(-(k s q.a)^2)."""
    cells = np.zeros((64, 64))
    cells[31, 2] = cells[31, 60] = 0.5
    angle = 58 * letter.pitch_m / letter.distance_m
    one = replace(letter, cells=cells, decorrelation=(0.0, 0.8 / angle))
    covariance = autocovariance([one.frame(1e8, rng) for _ in range(24)])[63, [63, 63 + 58]]
    # Of two equal cells the lag between them holds half of zero lag.
    assert 2.0 * covariance[1] / covariance[0] == pytest.approx(np.exp(-0.64), abs=0.1)


def test_memory_is_endless_where_the_wall_sends_light_back_whence_it_came(letter):
    reference = sim.load("corner_letter").geometry
    middle = 0.5 * (reference.hidden_object.centre + reference.camera.centre)
    back = replace(reference, camera=replace(reference.camera, pupil_centre=middle))
    assert np.hypot(*MemoryEffect.of(back).decorrelation) == pytest.approx(0.0, abs=1e-9)
    # 12 degrees off: k s tan(12 degrees), along the columns.
    rough = 2.0 * np.pi * 2e-6 / 532e-9
    assert abs(letter.decorrelation[1]) == pytest.approx(rough * np.tan(np.deg2rad(12.0)), rel=0.02)
    assert abs(letter.decorrelation[0]) < 0.05 * abs(letter.decorrelation[1])
