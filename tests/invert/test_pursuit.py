"""Objects of a capture, by the likelihood of their paths together."""

from __future__ import annotations

import numpy as np
import pytest

import correlograph as cg
from benchmarks.tracking_pairs import draw
from invert.tracking import pursuit
from invert.tracking.explained import CELL
from invert.tracking.likelihood import RIDGE, WHOLE, Likelihood
from invert.tracking.maxima import highest
from invert.tracking.pursuit import find_objects
from invert.tracking.several import Several
from invert.tracking.shares import Shares
from invert.tracking.shifts import weight_of
from invert.tracking.start import Start
from invert.tracking.tracker import _read_spectra, track
from tests.invert.field.speckle import fading_frames, letter, travelling_frames


def test_a_maximum_of_noise_is_no_object():
    """Nothing is left in common seven frames apart, and the highest maximum there is noise. All frames are likelier with the true path."""
    rng, step = np.random.default_rng(3), np.array([3.0, 1.5])
    spectra, band = _read_spectra(cg.Capture(fading_frames(rng, np.arange(16), step, 0.1, 0.1)), 1)
    cross = (spectra[:-7].conj() * spectra[7:]).mean(0)
    place, _ = highest(cross, band, weight_of(band, 0.0))
    path, by_noise = (np.arange(16)[:, None] * one for one in (step, place / 7.0))
    shares = Shares(spectra, band)
    assert shares.along(by_noise, 7) > 2.5 * shares.along(path, 7)
    likelihood = Likelihood(spectra, band, WHOLE)
    assert likelihood.rise([path]) > likelihood.rise([by_noise])
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


def test_the_likelihood_is_that_of_gaussian_coordinates():
    """A basis of the patterns of two paths orthogonal at each frequency."""
    rng, steps = np.random.default_rng(4), np.array([[2.5, -1.0], [-4.5, 6.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.array([3.0, 2.0]))[:7]), 1)
    likelihood, numbers = Likelihood(spectra, band, 2**30), np.arange(7)  # one block
    patterns = [likelihood.pattern(numbers[:, None] * one) for one in steps]
    inside = np.argwhere(band.counts > 0.0)
    turns = band.rows[inside[:, 0], None] * steps[:, 0] + band.columns[inside[:, 1], None] * steps[:, 1]
    vectors = np.exp(-2j * np.pi * turns[:, None] * numbers[:, None]) / 7.0**0.5  # (frequencies, frames, 2)
    first, overlap = vectors[..., 0], np.vecdot(vectors[..., 0], vectors[..., 1])
    second = vectors[..., 1] - overlap[:, None] * first
    left = np.linalg.norm(second, axis=1)
    clear = left**2 > 50.0 * RIDGE  # the others hardly count
    seen = spectra[:, inside[:, 0], inside[:, 1]].T
    squares = [np.abs(np.vecdot(first, seen)) ** 2, np.abs(np.vecdot(second, seen) / left) ** 2]
    coordinates = list(likelihood._coordinates(0, patterns, likelihood._shared_by(patterns)))
    order = np.lexsort((likelihood._columns, likelihood._rows))
    for one, expected in zip(coordinates, squares, strict=True):
        assert np.abs(one.squares[0, order] - expected)[clear].mean() < 0.01 * expected[clear].mean()
        assert np.all(one.noise[0, order][clear] > 0.9)
    cell = inside[:, 0] // CELL * 1000 + inside[:, 1] // CELL
    counts, total = 0.5 * band.counts[tuple(inside.T)] / band.noise_gain, 0.0
    for one, dimensions in [*((one, 1.0) for one in squares), ((np.abs(seen) ** 2).sum(1) - sum(squares), 5.0)]:
        for each in np.unique(cell):
            chosen = cell == each
            number = dimensions * counts[chosen].sum()
            total -= number * np.log((counts * one)[chosen].sum() / number)
    rise = likelihood.of(patterns) - likelihood.of([])
    assert rise == pytest.approx(total - likelihood.of([]), rel=0.03)


def test_a_path_through_noise_explains_half_a_unit_per_cell():
    """The variance of its coordinate is one number per cell."""
    spectra, band = _read_spectra(cg.Capture(two_patterns(np.random.default_rng(6), np.eye(2), np.ones(2))), 1)
    rng = np.random.default_rng(5)
    noise = rng.normal(size=spectra.shape) + 1j * rng.normal(size=spectra.shape)
    likelihood = Likelihood(noise.astype(np.complex64), band, 2**30)
    rises = [likelihood.rise([np.arange(20)[:, None] * step]) for step in rng.uniform(-4.0, 4.0, (40, 2))]
    found = np.mean(rises) * band.noise_gain / likelihood.cells
    assert found == pytest.approx(0.5, abs=0.25)


def test_powers_are_those_of_two_patterns():
    """Lights of 3 and 2: their powers are as 9 and 4. A third path explains next to nothing."""
    rng, steps = np.random.default_rng(4), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.array([3.0, 2.0]))), 1)
    numbers = np.arange(20)[:, None]
    paths = [numbers * one for one in (*steps, np.array([6.0, 2.0]))]
    several = Several(spectra, band, [10, 5], paths[0])
    powers = several.powers(paths)
    assert powers[:2].sum() == pytest.approx(1.0, abs=0.15)
    assert powers[0] / powers[1] == pytest.approx(9.0 / 4.0, rel=0.25)  # 1500 grains
    assert powers[2] < 0.05
    alone, both, three = (several.rise(paths[:count]) for count in (1, 2, 3))
    assert both > 1.3 * alone
    assert three - both < 0.05 * (both - alone)


def test_paths_settle_at_the_maximum_of_their_likelihood():
    """A path off by less than a grain moves to the exact one, beside another object; a single path between them becomes two."""
    rng, steps = np.random.default_rng(7), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.ones(2))), 1)
    numbers = np.arange(20)[:, None]
    several = Several(spectra, band, [10, 5], numbers * steps[0])
    for one, step in zip(several.settle([numbers * (steps[0] + 0.15), numbers * steps[1]]), steps, strict=True):
        assert np.abs(one[-1] / 19.0 - step).max() < 0.02
    found = several.add_object([numbers * (steps[0] + 0.15)], [numbers * (steps[1] - 0.1)])
    assert found is not None
    assert np.abs(np.stack(found)[:, -1] / 19.0 - steps).max() < 0.02
    assert several.add_object(found, [numbers * (steps[0] + 0.15)]) is None


@pytest.mark.parametrize("number", [429, pytest.param(402, marks=pytest.mark.slow), pytest.param(436, marks=pytest.mark.slow)])
def test_interfering_objects_are_told_apart_before_they_part_by_two_grains(number):
    """Scenes of `benchmarks.tracking_pairs` whose consecutive frames, and those up to eight apart, show one path between two objects."""
    frames, velocities, grain = draw(number, 2)
    found = cg.track(cg.Capture(frames))
    tracks, numbers = [found, *found.others], np.arange(len(frames))[:, None]
    assert len(tracks) == 2
    for velocity in velocities:
        assert min(np.abs(one.path_pixels - numbers * velocity).max() for one in tracks) < 2.0 * grain


def test_speckle_that_changes_is_no_second_object():
    """Two steady patterns describe one that fades better than one steady pattern, but not better than one that changes."""
    capture = cg.Capture(fading_frames(np.random.default_rng(9), np.arange(40), np.array([1.2, 0.6]), 0.01, 3.0))
    spectra, band = _read_spectra(capture, 1)
    path = np.arange(40)[:, None] * np.array([1.2, 0.6])
    several = Several(spectra, band, [24, 12, 6], path)
    settled = max(several.rise(several.settle(one)) for one in several._begun([path], [path]))
    assert settled > several.rise([path]) + 2.0 * several.cells
    assert several.add_object([path], [path]) is None
    assert len(cg.track(capture).others) == 0


def test_a_path_found_by_distant_frames_covers_the_capture(monkeypatch):
    """The middle of a capture decides whether consecutive frames show its only object; if not, all frames are searched."""
    monkeypatch.setattr(pursuit, "FRAMES_FOR_NUMBER", 10)
    monkeypatch.setattr(pursuit, "_pursue", lambda spectra, *_: [Start(np.zeros((len(spectra), 2)), 10.0, 0.5, lag=5)])
    rng, steps = np.random.default_rng(8), np.array([[2.5, -1.0], [-1.5, 3.0]])
    spectra, band = _read_spectra(cg.Capture(two_patterns(rng, steps, np.ones(2))), 1)
    (one,) = find_objects(spectra, band)
    assert len(one.path) == len(spectra) == 20


def test_few_frames_of_two_objects_that_hardly_part_have_a_warning():
    """Three frames, whose consecutive ones are the most distant that are compared: one object shares all of its speckle, two do not."""
    rng, numbers = np.random.default_rng(1), np.arange(3)[:, None]
    one, other = (
        travelling_frames(letter(), (320, 350), 256, rng, numbers * np.array(step), 1e9) for step in ((3.0, 1.0), (-2.0, 2.0))
    )
    assert track(cg.Capture([rng.poisson(light).astype(np.float32) for light in one])).warnings == ()
    warnings = track(
        cg.Capture([rng.poisson(first + second).astype(np.float32) for first, second in zip(one, other, strict=True)])
    ).warnings
    assert any(warning.startswith("consecutive frames share") for warning in warnings)
