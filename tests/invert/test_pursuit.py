"""What frames have in common along two paths is compared at all distances of frames by which an object is sought."""

from __future__ import annotations

import numpy as np

import correlograph as cg
from invert.tracking.maxima import highest
from invert.tracking.pursuit import _explains_alone
from invert.tracking.shifts import weight_of
from invert.tracking.start import Start, share_along
from invert.tracking.tracker import _read_spectra


def fading_frames(rng: np.random.Generator, step: np.ndarray, fading: float) -> list[np.ndarray]:
    """Return 16 frames of speckle that travels, and whose intensities k frames apart correlate by exp(-fading k^2)."""
    sides, numbers = (320, 360), np.arange(16)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * fading * (numbers[:, None] - numbers) ** 2))
    rows, columns = (np.fft.fftfreq(side) for side in sides)
    inside = (np.abs(rows[:, None]) < 0.12) & (np.abs(columns) < 0.07)
    fresh = rng.normal(size=(16, inside.sum())) + 1j * rng.normal(size=(16, inside.sum()))
    turn = (rows[:, None] * step[0] + columns * step[1])[inside]
    frames = []
    for number, amplitudes in enumerate((vectors * np.sqrt(np.maximum(values, 0.0))) @ fresh):
        field = np.zeros(sides, complex)
        field[inside] = amplitudes * np.exp(-2j * np.pi * number * turn)
        frames.append(np.abs(np.fft.ifft2(field))[:260, :300] ** 2)
    return [rng.poisson(0.1 * one / np.mean(frames)).astype(np.float32) for one in frames]


def test_a_maximum_of_noise_is_no_object():
    """Nothing is left in common seven frames apart, and the highest maximum there is noise. Four apart, the true path explains more."""
    rng, step = np.random.default_rng(3), np.array([3.0, 1.5])
    spectra, band = _read_spectra(cg.Capture(fading_frames(rng, step, 0.1)), 1)
    cross = (spectra[:-7].conj() * spectra[7:]).mean(0)
    place, _ = highest(cross, band, weight_of(band, 0.0))
    path, by_noise = (np.arange(16)[:, None] * one for one in (step, place / 7.0))
    assert share_along(spectra, band, by_noise, 7) > 2.5 * share_along(spectra, band, path, 7)
    assert _explains_alone(path, Start(by_noise, 10.0, 0.1, lag=7), spectra, band)
