"""Numbers of lags other than 63: coarse lags from fine ones, the choice of lags, reconstructions and truths of other sizes."""

import json

import numpy as np
import pytest

from correlograph import Result, Truth, aligned_pearson, reconstruct
from correlograph.errors import InputError
from invert.measure.coarsen import coarsen, pad
from invert.measure.estimate import Estimate
from invert.measure.lag_choice import choose_lags, upper_snr
from invert.measure.spectrum import read_measurement
from radiometry.autocorrelation import autocorrelate, patch_grid, smooth_by_window
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from tests.light import speckle

SHAPE, PATCH = (1100, 1210), 130


def frames_of(shown: np.ndarray, lag: float, photons: float, count: int = 2) -> np.ndarray:
    """Frames of an object of cells a third of a lag wide; lags of patches of 130 pixels."""
    rng = np.random.default_rng(3)
    row, column = (np.arange(side) * PATCH / side * 3.0 / lag for side in SHAPE)
    amplitude = np.sqrt(shown[row[row < len(shown)].astype(int)][:, column[column < shown.shape[1]].astype(int)])
    light = [speckle(amplitude, SHAPE, rng) for _ in range(count)]
    return rng.poisson(photons * np.stack(light)).astype(np.float32)


def letter(side: int) -> np.ndarray:
    """An F of side / 8 cells stroke width on a square of cells."""
    row, column = np.mgrid[:side, :side] / side
    return (((column < 0.2) | (row < 0.2) & (column < 0.7) | (row > 0.4) & (row < 0.6) & (column < 0.5)) & (row < 1.0)) * 1.0


@pytest.mark.parametrize(("size", "lags"), [(260, 127), (195, 95), (227, 111)])
def test_coarse_lags_follow_from_fine_ones(size, lags):
    """The estimate from smaller patches of the same frames weights the same pixel pairs."""
    seen = frames_of(letter(90), 1.0, 5.0)
    fine, coarse = (
        read_measurement(estimate_autocorrelation(seen, patch_grid(SHAPE, each, number))[0])
        for each, number in ((size, lags), (PATCH, 63))
    )
    found = coarsen(fine, 64)
    used = coarse.lag_grid.ring > 1
    scale = coarse.values[used].max()
    assert np.abs(found.values - coarse.values)[used].max() < 0.07 * scale
    assert np.corrcoef(found.values[used], coarse.values[used])[0, 1] > 0.998
    assert found.noise.floor == pytest.approx(coarse.noise.floor, rel=0.03)


def test_padding_adds_lags_of_the_floor(rng):
    measurement = read_measurement(1.0 + 0.01 * rng.normal(size=(65, 65)).astype(np.float32))
    padded = pad(measurement, 64)
    assert padded.values.shape == (127, 127)
    np.testing.assert_array_equal(padded.values[31:-31, 31:-31], measurement.values)
    assert padded.values[0, 5] == np.float32(measurement.noise.floor)


def choice(seen: np.ndarray):
    grid = patch_grid(SHAPE, PATCH)
    return choose_lags(grid, lambda tried: read_measurement(estimate_autocorrelation(seen, tried)[0]))


def test_lags_suit_the_object(rng):
    ordinary = choice(frames_of(letter(90), 1.0, 0.3)).grid
    assert (ordinary.size, ordinary.lags) == (PATCH, 63)
    empty = choice(rng.poisson(3.0, (2, *SHAPE)).astype(np.float32))
    assert (empty.grid.size, empty.grid.lags) == (PATCH, 63)
    assert "no object" in empty.reason
    small = choice(frames_of(letter(18), 1.0, 3.0))
    assert small.grid.size > 1.9 * PATCH
    assert "small" in small.reason
    row, column = np.mgrid[:90, :90]
    bars = ((row // 3) % 2 == 0) * ((column // 12) % 2 == 0) * 1.0  # cells of a third of a lag
    fine = choice(frames_of(bars, 1.0, 30.0, 12))
    assert fine.grid.size >= 2 * PATCH
    assert fine.grid.lags > 63
    assert "finer" in fine.reason


def test_the_upper_frequencies_of_noise_hold_no_signal(rng):
    estimates = [estimate_autocorrelation(rng.poisson(2.0, (2, *SHAPE)), patch_grid(SHAPE, PATCH))[0] for _ in range(4)]
    assert max(upper_snr(read_measurement(one)) for one in estimates) < 0.3


@pytest.mark.parametrize("lags", [32, 47, 90, 127])
def test_objects_of_other_numbers_of_lags(lags, tmp_path):
    """Noise-free letters of a third of the window, at every size that is not the default."""
    side = lags + 1
    truth = np.zeros((side, side), np.float32)
    truth[side // 8 : side // 8 + side // 2, side // 5 : side // 5 + side // 2] = letter(side // 2)
    signal = smooth_by_window(autocorrelate(truth))
    rng = np.random.default_rng(2)
    noise = rng.gamma(300.0, 1.0 / 300.0, signal.shape)
    lags_seen = (signal / signal.max() + 0.02) * np.where(
        np.arange(signal.size).reshape(signal.shape) < signal.size // 2, noise, noise[::-1, ::-1]
    )
    estimate = Estimate("letter", lags_seen.astype(np.float32), pitches_m=(2e-4, 2e-4))
    result = reconstruct(estimate, quality="fast")
    assert result.albedo.shape == (side, side)
    assert aligned_pearson(result.albedo, truth)[0] > 0.8
    summary = result.save(tmp_path, Truth(np.kron(truth, np.ones((2, 2), np.float32)), (1e-4, 1e-4)))
    assert summary["pearson"] == pytest.approx(aligned_pearson(result.albedo, truth)[0], abs=1e-6)
    np.testing.assert_array_equal(Result.load(tmp_path).albedo, result.albedo)
    assert json.loads((tmp_path / "result.json").read_text())["pitches_m"] == [2e-4, 2e-4]


def test_truths_are_averaged_over_the_lags(rng):
    albedo = rng.random((10, 10))
    truth = Truth(albedo, (1.0, 2.0))
    np.testing.assert_array_equal(truth.on_lags(10, (1.005, 2.0)), albedo.astype(np.float32))
    coarse = truth.on_lags(8, (2.0, 4.0))
    np.testing.assert_allclose(coarse[2, 3], albedo[1:3, 3:5].mean(), rtol=1e-6)
    assert coarse.sum() * 8.0 == pytest.approx(albedo.sum() * 2.0)  # the integral is kept
    assert truth.on_lags(40, (0.5, 1.0)).sum() * 0.5 == pytest.approx(albedo.sum() * 2.0)
    with pytest.raises(InputError, match="pitch"):
        Truth(albedo).on_lags(8, (1.0, 1.0))
    with pytest.raises(InputError, match="square albedo"):
        Truth(albedo[:5])
