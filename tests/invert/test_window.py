"""The window of a frame stays where it is: what it leaks to other frequencies does not hold speckle back, however large its grains."""

from __future__ import annotations

import numpy as np
import pytest

import correlograph as cg
from benchmarks.tracking_pairs import draw
from invert.tracking.band import TAPER
from invert.tracking.shifts import _slopes
from invert.tracking.spectra import Reader, _leakage
from invert.tracking.tracker import track


def test_power_beyond_the_band_is_what_the_window_leaks():
    """A field within 0.02 cycles per pixel, so that the intensity has no power beyond 0.04."""
    rng, shape, side = np.random.default_rng(5), (180, 250), 1024
    reader, frequencies = Reader(shape, 1), np.fft.fftfreq(side)
    inside = np.hypot(frequencies[:, None], frequencies) < 0.02
    through_window, whole = [], []
    for _ in range(60):
        field = np.fft.ifft2(inside * (rng.normal(size=inside.shape) + 1j * rng.normal(size=inside.shape)))
        intensity = np.abs(field) ** 2 / np.mean(np.abs(field) ** 2)
        through_window.append(np.abs(reader.whole(intensity[: shape[0], : shape[1]])) ** 2)
        whole.append(np.abs(np.fft.fft2(intensity - intensity.mean())) ** 2)
    measured = np.mean(through_window, 0)
    rows, columns = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    far = np.hypot(rows, columns) > 0.08
    # The power without the window, at the frequencies of the frame.
    true = np.zeros_like(measured)
    band = np.hypot(rows, columns) < 0.04
    autocorrelation = np.fft.ifft2(np.mean(whole, 0)).real[np.ix_(*(np.fft.fftfreq(one, 1 / one).astype(int) for one in shape))]
    full = np.fft.fft2(autocorrelation).real[:, : true.shape[1]].clip(0.0)
    true[band] = full[band] * measured[band].sum() / full[band].sum()
    assert _leakage(true, shape, TAPER)[far].sum() == pytest.approx(measured[far].sum(), rel=0.2)


def test_the_spectrum_of_round_grains_is_round():
    """The columns of zero are smoothed with their opposite, not with the highest."""
    rng, side = np.random.default_rng(3), 256
    inside = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)) < 0.05
    frames = []
    for _ in range(32):
        frames.append(np.abs(np.fft.ifft2(inside * (rng.normal(size=inside.shape) + 1j * rng.normal(size=inside.shape)))) ** 2)
    band = Reader((side, side), 1).band([rng.poisson(50.0 * one / np.mean(one)).astype(np.float32) for one in frames])
    assert band is not None
    middle, lags = int(np.argmin(np.abs(band.rows))), np.arange(4, 16)
    along = 0.5 * (band.signal[middle + lags, 0] + band.signal[middle - lags, 0])
    assert along.sum() == pytest.approx(band.signal[middle, lags].sum(), rel=0.1)


@pytest.mark.parametrize("number", [203, 206])
def test_speckle_of_large_grains_is_followed_within_its_errors(number):
    """Random objects of ten to fifteen grains across a frame; a steep window would hold them back by seven to seventeen errors."""
    frames, velocities, _ = draw(number, 1)
    found = track(cg.Capture(frames))
    deviation = found.path_pixels - np.arange(len(frames))[:, None] * velocities[0]
    assert (np.abs(deviation[1:]) < 4.0 * found.error_pixels[1:]).all()
    assert not found.others
    assert not found.warnings


def test_a_path_between_those_of_two_objects_is_doubted():
    frames, _, _ = draw(307, 2)
    found = track(cg.Capture(frames))
    assert not found.others
    assert "several objects have not moved apart" in " ".join(found.warnings)
    assert found.as_dict()["warnings"] == list(found.warnings)


def test_slopes_at_edges_of_a_band_are_those_inside():
    """A plane, of which a hole and a side are missing: its slope is the same everywhere."""
    places = np.array([0.0, 0.1, 0.3, 0.4, 0.7, 0.8, 0.9])
    inside = np.ones((7, 5), bool)
    inside[3, 2], inside[6] = False, False
    plane = np.where(inside, 3.0 * places[:, None] - 2.0 * np.arange(5.0), 0.0)
    assert _slopes(plane, inside, places, 0)[inside] == pytest.approx(3.0)
    assert _slopes(plane, inside, np.arange(5.0), 1)[inside] == pytest.approx(-2.0)
