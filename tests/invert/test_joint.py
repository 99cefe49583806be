"""Paths of several objects together, on Gaussian patterns that travel and fade as assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
from invert.tracking.band import Band
from invert.tracking.components import Components, unmix
from invert.tracking.joint import follow_several
from invert.tracking.normal_equations import WINDOW, NormalEquations
from invert.tracking.start import Start
from invert.tracking.tracker import track
from tests.invert.field.speckle import letter, travelling_fields, travelling_frames, white

SHAPE = (300, 420)
FADING = np.array([0.0005, 0.004])
NOISE = 0.4


def band_of(powers: np.ndarray) -> Band:
    """Rows from -20 to 20 and columns from 0 to 30 periods per frame."""
    rows, columns = np.arange(-20, 21) / SHAPE[0], np.arange(31) / SHAPE[1]
    counts = np.where(np.arange(31) > 0, 2.0, 1.0) * np.ones((41, 1))
    counts[:20, 0] = 0.0  # conjugates of the rows below
    return Band(SHAPE, rows, columns, counts, powers.sum(0), NOISE, NOISE)


def powers_of(ratio: float = 0.6) -> np.ndarray:
    """Powers (2, R, C) of a wide object and of a narrow, turned one, which is dimmer by a ratio."""
    row, column = np.arange(-20, 21)[:, None] / 20.0, np.arange(31)[None] / 30.0
    return np.stack(
        [
            4.0 * np.exp(-2.0 * row**2 - 3.0 * column**2),
            4.0 * ratio * np.exp(-5.0 * (row + 0.4 * column) ** 2 - 2.0 * column**2),
        ]
    )


def components_of(powers: np.ndarray) -> Components:
    return Components(powers, np.full(powers.shape[1:], NOISE), FADING)


def paths_of(frames: int, slow: float = 0.3) -> np.ndarray:
    """A curved path of 3 pixels per frame, and a slow one."""
    at = np.arange(frames)
    fast = np.stack([2.6 * at, 0.03 * at**2 - 1.1 * at], 1)
    return np.stack([fast, slow * np.stack([-0.4 * at, at + np.sin(at)], 1)])


def draw(paths: np.ndarray, powers: np.ndarray, band: Band, rng: np.random.Generator) -> np.ndarray:
    """Spectra (frames, R, C)."""
    at, spectra = np.arange(paths.shape[1]), 0.0
    for path, power, fading in zip(paths, powers, FADING, strict=True):
        alike = np.exp(-fading * (at[:, None] - at) ** 2) + 1e-9 * np.eye(len(at))
        field = np.tensordot(np.linalg.cholesky(alike), white((len(at), *power.shape), rng), 1) * power**0.5
        turn = path[:, :1, None] * band.rows[:, None] + path[:, 1:, None] * band.columns
        spectra = spectra + field * np.exp(-2j * np.pi * turn)
    return (spectra + NOISE**0.5 * white(spectra.shape, rng)).astype(np.complex64)


def starts_near(paths: np.ndarray, rng: np.random.Generator) -> list[Start]:
    """Approximate paths that are bent by two pixels."""
    bent = np.sin(np.linspace(0.0, 3.0, paths.shape[1]))[:, None] * rng.uniform(-2.0, 2.0, 2)
    return [Start(path + bent, 20.0, 0.4, 4, 8) for path in paths]


def test_powers_and_fading_are_those_of_each_object(rng):
    powers, paths = powers_of(), paths_of(40)
    band = band_of(powers)
    found = [unmix(draw(paths, powers, band, rng), band, paths) for _ in range(4)]
    assert np.mean([one.fading for one in found], 0) == pytest.approx(FADING, rel=0.2)
    mean, used = np.mean([one.powers for one in found], 0), band.counts > 0.0
    for one, power in zip(mean, powers, strict=True):
        assert (one * used).sum() == pytest.approx((power * used).sum(), rel=0.08)
        assert np.corrcoef(one[used], power[used])[0, 1] > 0.95
    assert found[0].in_common(band, 40).shape == (2, 16)
    assert found[0].in_common(band, 5).shape == (2, 4)


def test_the_score_is_the_slope_of_the_likelihood(rng):
    powers, paths = powers_of(), paths_of(7)
    band = band_of(powers)
    components = components_of(powers)
    places = np.argwhere(band.counts > 0.0)[::40]
    normal = NormalEquations.of(draw(paths, powers, band, rng), band, components, places)

    def log_likelihood(at: np.ndarray) -> float:
        total, numbers = 0.0, np.arange(at.shape[1])
        for turn, count, seen, own in zip(normal.turns, normal.weights, normal.values, normal.powers.T, strict=True):
            covariance = NOISE * np.eye(len(numbers), dtype=complex)
            for path, power, fading in zip(at, own, FADING, strict=True):
                phase = np.exp(-1j * path @ turn)
                covariance += power * np.exp(-fading * (numbers[:, None] - numbers) ** 2) * np.outer(phase, phase.conj())
            inverse = np.linalg.inv(covariance)
            total -= count * (np.linalg.slogdet(covariance)[1] + (seen.conj() @ inverse @ seen).real)
        return total

    slopes = normal.score(paths)
    for number, frame, axis in ((0, 2, 0), (1, 6, 1), (0, 5, 1)):
        moved = np.zeros_like(paths)
        moved[number, frame, axis] = 1e-3
        slope = (log_likelihood(paths + moved) - log_likelihood(paths - moved)) / 2e-3
        assert slopes[frame, number, axis] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(slopes).max())


@pytest.mark.parametrize(("frames", "slow", "low"), [(30, 0.3, 0.5), (30, 2.5, 0.5), (2 * WINDOW + 8, 0.3, 0.3)])
def test_errors_are_those_of_the_likelihood(frames, slow, low, rng):
    """Deviations over standard errors, with the change of the illumination left out: these patterns have none of its phases."""
    powers, paths = powers_of(), paths_of(frames, slow)
    band, squares = band_of(powers), []
    places = np.argwhere(band.counts > 0.0)
    components = components_of(powers)
    begun = NormalEquations.of(np.zeros((frames, *powers.shape[1:])), band, components, places).add_information(paths)
    variance, bend = begun.errors()
    for _ in range(6):
        drawn = draw(paths, powers, band, rng)
        found = replace(NormalEquations.of(drawn, band, components, places), informations=begun.informations).solve(paths)
        squares.append((found - found[:, :1])[:, 1:] ** 2 / variance[:, 1:])
        followed = follow_several(drawn, band, starts_near(paths, rng))
        for one, path, most in zip(followed, paths, np.sqrt(variance), strict=True):
            deviation = one.path - (path - path[0])
            assert one.frames_per_group == 1
            assert np.sqrt((deviation**2).mean()) < 3.0 * most.max()
            assert np.all(one.error[1:] > 0.7 * most[1:] * band.noise_gain**0.5)
    assert low < np.mean(squares) < 1.5
    assert np.all(bend > 0.0)


def test_a_slow_object_is_not_drawn_by_a_fast_one(rng):
    """A remainder of the fast object would pull the slow one along."""
    powers, paths = powers_of(1.5), paths_of(30, 0.0)
    band, drawn, errors = band_of(powers), [], []
    along = paths[0, -1] / np.linalg.norm(paths[0, -1])
    for _ in range(6):
        slow = follow_several(draw(paths, powers, band, rng), band, starts_near(paths, rng))[1]
        assert slow.frames_per_group == 1
        drawn.append(slow.path[-1] @ along)
        errors.append(np.linalg.norm(slow.error[-1] * along))
    assert np.abs(np.mean(drawn)) < 3.0 * np.mean(errors) / len(drawn) ** 0.5
    assert np.std(drawn) < 1.7 * np.mean(errors)


def dim(powers: np.ndarray, times: float) -> tuple[np.ndarray, Band]:
    band = band_of(powers)
    return times * powers, replace(band, signal=times * band.signal)


def test_dim_frames_share_positions(rng):
    paths = paths_of(64)
    powers, band = dim(powers_of(1.0), 0.05)
    equations = NormalEquations.of(
        draw(paths, powers, band, rng),
        band,
        components_of(powers),
        np.argwhere(band.counts),
    ).add_information(paths)
    errors = {length: replace(equations, length=length).errors_between_neighbours() for length in equations.lengths()}
    assert list(errors) == [1, 2, 4, 8, 16]
    assert np.all(errors[4] < errors[1])
    for length in (4, 16):
        longer = replace(equations, length=length)
        step = longer.solve(paths)
        assert np.abs(np.diff(step[:, :length], 2, axis=1)).max() < 1e-9  # straight between two positions
        variance, _ = longer.errors()
        assert np.all(variance[:, 1:].mean(1) < equations.errors()[0][:, 1:].mean(1))


def test_dark_frames_keep_the_approximate_path(rng):
    powers, band = dim(powers_of(), 1e-4)
    paths = paths_of(40)
    starts, drawn = starts_near(paths, rng), draw(paths, powers, band, rng)
    followed = follow_several(drawn, band, starts)
    assert all(np.array_equal(one.path, start.path) for one, start in zip(followed, starts, strict=True))
    assert np.all(followed[0].error[1:] >= band.grain_pixels)
    assert float(unmix(drawn, band, paths).powers.sum()) < 0.02 * NOISE * band.signal.size


def test_an_object_without_light_does_not_take_the_others_along(rng):
    powers, paths = powers_of(), paths_of(30)
    band = band_of(powers)
    ghost = Start(np.stack([-2.0 * np.arange(30), 2.5 * np.arange(30)], 1), 6.0, 0.01, 4, 8)
    bright = follow_several(draw(paths, powers, band, rng), band, [*starts_near(paths, rng), ghost])
    for one, path in zip(bright, paths, strict=False):
        assert np.abs(one.path - path).max() < 1.5
        assert one.frames_per_group == 1
    assert np.array_equal(bright[2].path, ghost.path)
    assert np.isfinite(replace(band, signal=0.0 * bright[2].power).cells)


def test_three_objects_and_few_frames(rng):
    powers, paths = powers_of(), paths_of(30)
    third = np.stack([0.2 * np.arange(30), -3.1 * np.arange(30)], 1)
    paths, powers = np.concatenate([paths, third[None]]), np.concatenate([powers, powers[:1]])
    band = band_of(powers)
    drawn = sum(draw(paths[[n, n]], np.stack([powers[n], 0.0 * powers[n]]), band, rng) for n in range(3)) / 3.0**0.5
    found = follow_several(drawn, replace(band, signal=band.signal / 3.0), starts_near(paths, rng))
    assert all(np.abs(one.path - path).max() < 2.0 for one, path in zip(found, paths, strict=True))
    for frames in (3, 4, 2 * WINDOW, 2 * WINDOW + 1):
        paths = paths_of(frames)
        found = follow_several(
            draw(paths, powers_of(), band_of(powers_of()), rng), band_of(powers_of()), starts_near(paths, rng)
        )
        assert all(np.all(np.isfinite(one.error)) and one.path.shape == (frames, 2) for one in found)


def test_objects_that_move_together_keep_their_approximate_paths(rng):
    """Their interference looks like them."""
    powers, paths = powers_of(), paths_of(30)
    band = band_of(powers)
    paths[1] = 0.9 * paths[0]
    starts = starts_near(paths, rng)
    followed = follow_several(draw(paths, powers, band, rng), band, starts)
    assert all(np.array_equal(one.path, start.path) for one, start in zip(followed, starts, strict=True))


def test_paths_of_two_objects_with_large_grains_are_within_their_errors():
    """Intensities that add, grains of 12 and 20 pixels in frames of 301 x 421: windows draw both paths by 1 to 4 %."""
    worst, numbers = [], np.arange(40)[:, None]
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        paths = [numbers * np.array(step) for step in ((3.0, -1.0), (-2.0, 2.0))]
        one = travelling_frames(letter(40, 16), (301, 421), 256, rng, paths[0], 1e9)
        other = travelling_frames(letter(40, 16).T, (301, 421), 420, rng, paths[1], 1e9)
        frames = [rng.poisson(0.5 * (first + second)).astype(np.float32) for first, second in zip(one, other, strict=True)]
        found = track(cg.Capture(frames))
        assert len(found.others) == 1
        both = (found, *found.others)
        for path in paths:
            one = min(both, key=lambda each: np.abs(each.path_pixels - path).max())
            worst.append(np.abs((one.path_pixels - path)[1:] / one.error_pixels[1:]).max())
    assert max(worst) < 4.0


@pytest.mark.parametrize(("seed", "step"), [(0, (0.0, 0.0)), (1, (-2.5, 2.3)), (2, (1.8, 4.9))])
def test_a_path_that_interference_draws_has_a_larger_error_or_a_warning(seed, step):
    """The fields of a tall object and of a wide one overlap and add, in frames of a few hundred grains. There is no third path, although
    interference moves as neither object does. Without this error, such paths are off by up to 13 stated ones."""
    rng, numbers = np.random.default_rng(seed), np.arange(12)[:, None]
    paths = [numbers * np.array(one) for one in ((4.1, -2.4), step)]
    tall, wide = np.zeros((2, 64, 64))
    tall[16:48, 22:40] = wide[24:36, 12:52] = wide[24:46, 12:22] = 1.0
    one, other = (
        travelling_fields(albedo, (331, 390), patch, rng, path, 1e9)
        for albedo, patch, path in ((tall, 256, paths[0]), (wide, 300, paths[1]))
    )
    frames = [
        rng.poisson(0.5 * np.abs(first + 0.8 * second) ** 2).astype(np.float32)
        for first, second in zip(one, other, strict=True)
    ]
    found = track(cg.Capture(frames))
    assert len(found.others) == 1
    for one in (found, *found.others):
        away = min((one.path_pixels - path for path in paths), key=lambda each: np.abs(each).max())
        assert np.abs(away[1:] / one.error_pixels[1:]).max() < 4.0 or any("interfere" in doubt for doubt in one.warnings)
