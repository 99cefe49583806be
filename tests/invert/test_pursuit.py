"""Light that paths explain, together and alone."""

from __future__ import annotations

import numpy as np
import pytest

import correlograph as cg
from invert.tracking import pursuit
from invert.tracking.candidates import Candidates
from invert.tracking.explained import Explained
from invert.tracking.maxima import highest
from invert.tracking.pursuit import find_objects
from invert.tracking.shares import Shares
from invert.tracking.shifts import weight_of
from invert.tracking.start import Start
from invert.tracking.tracker import _read_spectra
from tests.invert.field.speckle import fading_frames


def test_a_maximum_of_noise_is_no_object():
    """Nothing is left in common seven frames apart, and the highest maximum there is noise. Four apart, the true path explains more."""
    rng, step = np.random.default_rng(3), np.array([3.0, 1.5])
    spectra, band = _read_spectra(cg.Capture(fading_frames(rng, np.arange(16), step, 0.1, 0.1)), 1)
    cross = (spectra[:-7].conj() * spectra[7:]).mean(0)
    place, _ = highest(cross, band, weight_of(band, 0.0))
    path, by_noise = (np.arange(16)[:, None] * one for one in (step, place / 7.0))
    shares = Shares(spectra, band)
    assert shares.along(by_noise, 7) > 2.5 * shares.along(path, 7)
    explained = Explained(spectra, band, [7, 3])
    assert explained.by([explained.add(path)]) > explained.by([explained.add(by_noise)])
    (one,) = find_objects(spectra, band)
    assert np.abs(one.path - path).max() < 3.0


def two_patterns(rng: np.random.Generator, steps: np.ndarray, lights: np.ndarray) -> list[np.ndarray]:
    """Return 20 frames of patterns that travel by steps (2, 2) pixels and add, with a mean of lights (2,)."""
    sides = (330, 390)
    rows, columns = (np.fft.fftfreq(side) for side in sides)
    inside = (np.abs(rows[:, None]) < 0.10) & (np.abs(columns) < 0.06)
    fields = [(rng.normal(size=sides) + 1j * rng.normal(size=sides)) * inside for _ in steps]
    frames = np.zeros((20, 240, 270))
    for field, step, light in zip(fields, steps, lights, strict=True):
        turn = rows[:, None] * step[0] + columns * step[1]
        moved = [np.abs(np.fft.ifft2(field * np.exp(-2j * np.pi * number * turn))) ** 2 for number in range(20)]
        frames += light * np.stack(moved)[:, :240, :270] / np.mean(moved)
    return list(rng.poisson(frames).astype(np.float32))


def test_powers_are_those_of_two_patterns():
    """Lights of 3 and 2: their powers are as 9 and 4. Only both paths explain both, whatever belongs to them, and a third adds noise."""
    rng, steps = np.random.default_rng(4), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.array([3.0, 2.0]))), 1)
    numbers = np.arange(20)[:, None]
    explained = Explained(spectra, band, [10, 5])
    first, second, third = (explained.add(numbers * one) for one in (*steps, np.array([6.0, 2.0])))
    both = explained.by([first, second])
    powers = explained.powers([first, second, third])
    assert powers[:2].sum() == pytest.approx(1.0, abs=0.15)
    assert powers[0] / powers[1] == pytest.approx(9.0 / 4.0, rel=0.25)  # 1500 grains
    assert powers[2] < 0.05
    assert both == pytest.approx(explained.by([first]) + explained.by([second]), rel=0.1)
    assert explained.by([first, second, third]) - both < 0.01 * both


def test_a_path_explains_half_a_unit_of_noise_per_cell():
    """Powers are fitted as at least zero: half of the cells of noise explain one unit each."""
    spectra, band = _read_spectra(cg.Capture(two_patterns(np.random.default_rng(6), np.eye(2), np.ones(2))), 1)
    rng = np.random.default_rng(5)
    noise = rng.normal(size=spectra.shape) + 1j * rng.normal(size=spectra.shape)
    noise = (noise * np.sqrt(0.5 * (band.signal + band.floor))).astype(np.complex64)
    noise[:, :, 0].imag = 0.0
    found = []
    explained = Explained(noise, band, [5, 3])
    for step in rng.uniform(-4.0, 4.0, (40, 2)):
        found.append(explained.by([explained.add(np.arange(20)[:, None] * step)]))
    assert np.mean(found) / explained.cells == pytest.approx(0.5, rel=0.2)


def test_a_better_candidate_takes_the_place_of_an_object():
    """A path off by less than a grain is exchanged for the exact one, beside another object."""
    rng, steps = np.random.default_rng(7), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.ones(2))), 1)
    numbers = np.arange(20)[:, None]
    candidates = Candidates(spectra, band, [10, 5])
    candidates.add(Start(numbers * one, 10.0, 0.5, lag=10) for one in (steps[0] + 0.15, *steps))
    assert candidates.exchange([0, 2]) == [1, 2]
    assert candidates.best_beside([1]) == 2
    assert candidates.best_beside([1, 2]) is None  # the first is not apart from the second


def test_a_path_found_by_distant_frames_covers_the_capture(monkeypatch):
    """The middle of a capture decides whether consecutive frames show its only object; if not, all frames are searched."""
    monkeypatch.setattr(pursuit, "FRAMES_FOR_NUMBER", 10)
    monkeypatch.setattr(pursuit, "_pursue", lambda spectra, *_: [Start(np.zeros((len(spectra), 2)), 10.0, 0.5, lag=5)])
    rng, steps = np.random.default_rng(8), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.ones(2))), 1)
    (one,) = find_objects(spectra, band)
    assert len(one.path) == len(spectra) == 20
