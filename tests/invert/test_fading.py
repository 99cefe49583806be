"""Likelihood of patterns that fade, against the density of Gaussian spectra."""

from __future__ import annotations

import numpy as np
import pytest

from invert.tracking.band import Band
from invert.tracking.climb import climb
from invert.tracking.fading import FINE, LENGTHS, WINDOW, FadingLikelihood, Powers, Step
from tests.invert.field.speckle import white

SHAPE = (300, 420)
NOISE = 0.4


def band_of() -> Band:
    """Rows from -15 to 15 and columns from 0 to 20 periods per frame, fewer frequencies than are used at most."""
    rows, columns = np.arange(-15, 16) / SHAPE[0], np.arange(21) / SHAPE[1]
    counts = np.where(np.arange(21) > 0, 2.0, 1.0) * np.ones((31, 1))
    counts[:15, 0] = 0.0  # conjugates of the rows below
    counts[20:, 14:] = 0.0
    return Band(SHAPE, rows, columns, counts, np.full(counts.shape, 3.0), NOISE, NOISE)


def paths_of(frames: int) -> list[np.ndarray]:
    at = np.arange(frames)
    return [np.stack([2.6 * at, 0.03 * at**2 - 1.1 * at], 1), np.stack([-1.4 * at, at + np.sin(at)], 1)]


def draw(paths: list[np.ndarray], powers: np.ndarray, band: Band, rng: np.random.Generator) -> np.ndarray:
    """Spectra (frames, R, C) of patterns of some powers (n, lengths)."""
    at, spectra = np.arange(len(paths[0])), 0.0
    for path, own in zip(paths, powers, strict=True):
        turn = path[:, :1, None] * band.rows[:, None] + path[:, 1:, None] * band.columns
        for length, power in zip(LENGTHS, own, strict=True):
            alike = np.exp(-(((at[:, None] - at) / length) ** 2)) + 1e-6 * np.eye(len(at))
            field = np.tensordot(np.linalg.cholesky(alike), white((len(at), *band.counts.shape), rng), 1)
            spectra = spectra + power**0.5 * field * np.exp(-2j * np.pi * turn)
    return spectra + NOISE**0.5 * white(spectra.shape, rng)


def fit(likelihood: FadingLikelihood, paths: list[np.ndarray]) -> Step:
    """The likelihood of paths at their most likely powers."""
    found = likelihood.step(paths, likelihood.begin(len(paths)))
    for _ in range(40):
        found = likelihood.step(paths, found.powers, moves=True)
    return found


POWERS = np.array([[0.0, 0.5, 0.0, 2.0, 0.0], [0.1, 0.0, 0.7, 0.0, 0.3]])


def test_the_height_is_the_density_of_the_spectra(rng):
    """All frequencies of the band one by one, with the covariance of the definition."""
    band, paths = band_of(), paths_of(7)
    spectra = draw(paths, POWERS, band, rng)
    likelihood, at = FadingLikelihood(spectra, band, FINE, np.ones(len(spectra), bool)), np.arange(7)
    count = int((band.counts > 0.0).sum())
    powers = Powers(np.repeat(POWERS[..., None], count, 2), np.full(count, NOISE))
    total = without = 0.0
    mean = {}
    for row, column in np.argwhere(band.counts > 0.0):
        mean.setdefault((row // 4, column // 4), []).append(
            (band.counts[row, column], (np.abs(spectra[:, row, column]) ** 2).mean())
        )
    for row, column in np.argwhere(band.counts > 0.0):
        covariance, seen = NOISE * np.eye(7, dtype=complex), spectra[:, row, column]
        for path, own in zip(paths, POWERS, strict=True):
            phase = np.exp(-2j * np.pi * (path[:, 0] * band.rows[row] + path[:, 1] * band.columns[column]))
            alike = sum(
                power * np.exp(-(((at[:, None] - at) / length) ** 2)) for length, power in zip(LENGTHS, own, strict=True)
            )
            covariance += alike * np.outer(phase, phase.conj())
        weight = 0.5 * band.counts[row, column] / band.noise_gain
        total -= weight * (np.linalg.slogdet(covariance)[1] + (seen.conj() @ np.linalg.inv(covariance) @ seen).real)
        counts, means = np.array(mean[row // 4, column // 4]).T
        power = (counts * means).sum() / counts.sum()
        without -= weight * (7.0 * np.log(power) + (np.abs(seen) ** 2).sum() / power)
    assert likelihood.step(paths, powers).height == pytest.approx(total - without, rel=1e-9)


def test_slope_and_powers_lead_up(rng):
    """The slope is that of the height, each round raises it, and the powers found are those drawn."""
    band, paths = band_of(), paths_of(30)
    likelihood = FadingLikelihood(draw(paths, POWERS, band, rng), band, FINE, np.ones(len(paths[0]), bool))
    powers, heights = likelihood.begin(2), []
    for _ in range(60):
        found = likelihood.step(paths, powers, moves=True)
        powers, heights = found.powers, [*heights, found.height]
    assert np.all(np.diff(heights) > -1e-6 * np.abs(heights[-1]))
    assert powers.patterns.sum(1).mean(1) == pytest.approx(POWERS.sum(1), rel=0.15)
    assert powers.noise.mean() == pytest.approx(NOISE, rel=0.1)
    found, numbers = likelihood.step(paths, powers, moves=True), np.arange(30)[:, None]
    for one, axis in ((0, 0), (0, 1), (1, 1)):
        moved = [
            [path + sign * 1e-4 * numbers * np.eye(2)[axis] * (one == index) for index, path in enumerate(paths)]
            for sign in (1, -1)
        ]
        up, down = (likelihood.step(each, powers).height for each in moved)
        assert found.slope[one, axis] == pytest.approx((up - down) / 2e-4, rel=1e-4, abs=1e-3)
    assert np.all(np.linalg.eigvalsh(found.information) > 0.0)


def test_the_information_is_the_variance_of_the_slope(rng):
    """Over ten draws of independent frequencies, of which each velocity sees about six hundred: within a third."""
    band, paths, slopes = band_of(), paths_of(20), []
    for _ in range(10):
        spectra = draw(paths, POWERS, band, rng)
        likelihood = FadingLikelihood(spectra, band, FINE, np.ones(len(spectra), bool))
        count = int((band.counts > 0.0).sum())
        found = likelihood.step(paths, Powers(np.repeat(POWERS[..., None], count, 2), np.full(count, NOISE)), moves=True)
        # Weights count conjugates, and the correlation of neighbours by the window, which these spectra do not have.
        slopes.append(found.slope.ravel() ** 2 / found.information.diagonal() * band.noise_gain)
    assert np.mean(slopes) == pytest.approx(1.0, rel=0.45)


def test_long_captures_are_windows(rng):
    """Twice as many frames as a window are two of them, without what they share."""
    band, paths = band_of(), paths_of(2 * WINDOW)
    spectra = draw(paths, POWERS, band, rng)
    halves = np.arange(2 * WINDOW) < WINDOW
    count = int((band.counts > 0.0).sum())
    powers = Powers(np.repeat(POWERS[..., None], count, 2), np.full(count, NOISE))
    whole, *parts = (FadingLikelihood(spectra, band, FINE, used) for used in (halves | ~halves, halves, ~halves))
    nothing = np.zeros((0, len(LENGTHS), count))
    noise_alone = [one.step([], Powers(nothing, one._total)).height for one in (whole, *parts)]
    assert noise_alone == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    separate = sum(one.step(paths, powers).height + one._none for one in parts)
    assert whole.step(paths, powers).height + whole._none == pytest.approx(separate, rel=1e-9)


def test_paths_climb_to_the_maximum(rng):
    """From 0.3 pixels per frame beside, which is six pixels at the end: within the error by the information."""
    band, paths, numbers = band_of(), paths_of(20), np.arange(20)[:, None]
    likelihood = FadingLikelihood(draw(paths, POWERS, band, rng), band, FINE, np.ones(len(paths[0]), bool))
    begun = [paths[0] + 0.3 * numbers * np.array([1.0, -1.0]), paths[1] + 0.3 * numbers * np.array([0.0, 1.0])]
    found, reached = climb(likelihood, begun, 0.3)
    away = np.stack([(one - path)[-1] / 19.0 for one, path in zip(found, paths, strict=True)])
    at_truth, at_begin, at_maximum = (fit(likelihood, one) for one in (paths, begun, found))
    error = np.sqrt(np.linalg.inv(at_maximum.information).diagonal()).reshape(2, 2)
    assert np.abs(away / error).max() < 4.0
    assert np.abs(away).max() < 0.05
    assert at_maximum.height > max(at_begin.height + 100.0, at_truth.height)
    assert reached == pytest.approx(at_maximum.height, abs=20.0)
