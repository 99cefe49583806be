"""Maxima in proportion to the distance of frames, and objects that the fringes of a scene do not let appear apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import fftfreq, fftshift, rfftfreq

from benchmarks.tracking_pairs import draw
from invert.tracking.band import Band
from invert.tracking.maxima import Crossed, maxima
from invert.tracking.pursuit import find_objects
from invert.tracking.shifts import weight_of
from invert.tracking.spectra import Reader
from invert.tracking.start import are_apart

SHAPE = (150, 210)


def band_of(albedo: np.ndarray) -> Band:
    """Return the band of an object whose albedo (H, W) is given per coefficient of the spectrum."""
    spectrum = np.zeros(SHAPE)
    spectrum[: albedo.shape[0], : albedo.shape[1]] = albedo
    power = np.fft.ifft2(np.abs(np.fft.fft2(spectrum)) ** 2).real[:, : SHAPE[1] // 2 + 1]
    rows = fftshift(fftfreq(SHAPE[0]))
    counts = np.where(np.arange(SHAPE[1] // 2 + 1) > 0, 2.0, 1.0) * np.ones((SHAPE[0], 1))
    return Band(SHAPE, rows, rfftfreq(SHAPE[1]), counts, fftshift(power, 0), *(2 * [1e-3 * power.max()]))


def moved(band: Band, pixels: np.ndarray) -> np.ndarray:
    """Return the cross-spectrum of speckle that has moved by pixels (2,)."""
    turns = band.rows[:, None] * pixels[0] + band.columns * pixels[1]
    return band.signal * np.exp(-2j * np.pi * turns)


def test_motion_in_proportion_is_found_below_a_higher_maximum_out_of_proportion():
    band = band_of(np.random.default_rng(0).uniform(size=(30, 42)))
    scales, true, other = np.array([1.0, 0.8, 0.5]), np.array([31.5, -18.25]), np.array([-20.0, 7.0])
    cross = np.stack([0.3 * moved(band, scale * true) for scale in scales])
    cross[0] += 0.6 * moved(band, other)
    weight = weight_of(band, 0.0)
    places, heights, _ = maxima(Crossed(cross.astype(np.complex64), scales, band.signal, 1000), band, weight, 1)
    np.testing.assert_allclose(places, [true], atol=0.3)
    assert heights[0] == pytest.approx(0.3 * weight.full, rel=0.2)


def test_parts_beside_each_other_do_not_make_two_displacements_differ():
    """Two squares of 12 coefficients, 40 apart along the rows: fringes of 150 / 40 pixels within grains of 150 / 12 by 210 / 12."""
    albedo = np.zeros((52, 12))
    albedo[:12], albedo[40:] = 1.0, 1.0
    parts, square = band_of(albedo), band_of(np.ones((12, 12)))
    width = np.array([SHAPE[0] / 12, 0.0])
    for one in (parts, square):
        assert not one.are_apart(0.5 * width)
        assert one.are_apart(2.0 * width)
    assert parts.grain_pixels < 0.5 * square.grain_pixels  # by which the two would be apart at half a width


@pytest.mark.parametrize(("swing", "is_apart"), [(0.0, True), (1.0, False)])
def test_a_path_that_an_object_crosses_now_and_then_is_not_apart(swing, is_apart):
    """Two paths move apart by 2.5 grains in four frames; with a swing, in only half of the time by more than one."""
    band, numbers = band_of(np.ones((12, 12))), np.arange(41)
    apart = 0.25 * 2.5 * SHAPE[0] / 12 * np.cumsum(1.0 - swing * np.sign(np.sin(2.0 * np.pi * (numbers - 0.5) / 20.0)))
    one = np.stack([3.0 * numbers, -1.0 * numbers], 1)
    other = one + np.stack([apart, np.zeros(41)], 1)
    relative = apart[4:] - apart[:-4]
    assert band.are_apart(np.array([np.median(relative), 0.0]))
    assert are_apart(one, other, 4, band) is is_apart


@pytest.mark.parametrize("number", [0, 2])
def test_two_that_interfere_are_two(number):
    """Random pairs on small frames: the paths of both, and no third."""
    frames, velocities, grain = draw(number, 2)
    reader = Reader(frames[0].shape, 1)
    band = reader.band(frames)
    assert band is not None
    found = find_objects(reader.all_spectra(frames, band), band)
    assert len(found) == 2
    ends, ways = [one.path[-1] for one in found], velocities * (len(frames) - 1)
    for way in ways:
        assert min(np.linalg.norm(end - way) for end in ends) < max(3.0 * grain, 0.05 * np.linalg.norm(way))
