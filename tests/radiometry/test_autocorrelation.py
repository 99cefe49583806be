"""Patches, lags, and the published estimator, against closed forms and a slow direct sum."""

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.lags import LAGS
from radiometry.autocorrelation import autocorrelate, automatic_patch_size, patch_grid, peak_of_cell_means, smooth_by_window
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation


def slow_lag(patches: list[np.ndarray], row: int, column: int) -> np.ndarray:
    """Spectrum of each patch at one lag, by the defining sum."""
    size = patches[0].shape[0]
    position = np.arange(size)
    wave = np.exp(-2j * np.pi * (row * position[:, None] + column * position[None, :]) / size)
    return np.array([(patch * wave).sum() for patch in patches])


@pytest.mark.parametrize("lag", [(0, 0), (1, 0), (0, 3), (-5, 7), (63, -63), (-63, 0)])
def test_two_frames_match_the_definition(rng, lag):
    frames = [rng.gamma(2.0, 3.0, (280, 412)) for _ in range(2)]
    grid = patch_grid((280, 412), 131)
    estimate, dof = estimate_autocorrelation(frames, grid, "published")
    cut = [[frame[r * 140 : r * 140 + 131, c * 206 : c * 206 + 131] for r in range(2) for c in range(2)] for frame in frames]
    first, second = (slow_lag(patches, *lag) for patches in cut)
    expected = (np.abs(first - second) ** 2 / 2).sum() / (4 * 131**2)
    assert dof == 4
    assert (grid.rows, grid.columns) == (2, 2)
    assert estimate[LAGS + lag[0], LAGS + lag[1]] == pytest.approx(expected, rel=2e-4)


def test_one_frame_is_pooled_over_patches(rng):
    frame = rng.gamma(2.0, 3.0, (262, 262))
    estimate, dof = estimate_autocorrelation([frame], patch_grid((262, 262), 131), "published")
    spectra = slow_lag([frame[:131, :131], frame[:131, 131:], frame[131:, :131], frame[131:, 131:]], 4, -9)
    assert dof == 3
    assert estimate[LAGS + 4, LAGS - 9] == pytest.approx((np.abs(spectra - spectra.mean()) ** 2).sum() / (3 * 131**2), rel=2e-4)


def test_white_noise_gives_its_variance_and_k(rng):
    frames = [rng.poisson(0.4, (1040, 1040)) for _ in range(3)]
    estimate, dof = estimate_autocorrelation(frames, patch_grid((1040, 1040), 130), "published")
    assert dof == 128
    half = estimate[LAGS + 1 :, :]
    assert half.mean() == pytest.approx(0.4, rel=0.01)
    assert half.mean() ** 2 / half.var() == pytest.approx(dof, rel=0.06)


def test_estimate_is_centro_symmetric_and_blind_to_a_fixed_pattern(rng):
    pattern = 50.0 * rng.random((262, 400))
    frames = [rng.poisson(3.0, (262, 400)).astype(float) for _ in range(2)]
    grid = patch_grid((262, 400), 131)
    plain, _ = estimate_autocorrelation(frames, grid, "published")
    lifted, _ = estimate_autocorrelation([frame + pattern for frame in frames], grid, "published")
    assert np.array_equal(plain, plain[::-1, ::-1])
    np.testing.assert_allclose(lifted, plain, rtol=2e-3, atol=1e-3)


def test_the_reference_frame_is_cut_as_the_paper_cuts_it():
    size = automatic_patch_size((2056, 2464), (532e-9, 1.0, 6.9e-6))
    grid = patch_grid((2056, 2464), size)
    assert (size, grid.rows, grid.columns) == (257, 8, 8)
    assert grid.lag_pitch_m(532e-9, 1.0, 6.9e-6) == pytest.approx(300e-6, rel=1e-3)
    assert automatic_patch_size((2056, 2464)) == 257


@pytest.mark.parametrize(("shape", "size"), [((100, 300), 127), ((300, 300), 126), ((300, 500), 301)])
def test_impossible_patches_are_refused(shape, size):
    with pytest.raises(InputError, match="patch"):
        patch_grid(shape, size)


def test_autocorrelate_matches_the_sum(rng):
    albedo = rng.random((5, 5))
    lags = autocorrelate(albedo)
    assert lags.shape == (9, 9)
    assert lags[4, 4] == pytest.approx((albedo**2).sum())
    assert lags[4 + 1, 4 - 2] == pytest.approx((albedo[:-1, 2:] * albedo[1:, :-2]).sum())


def test_window_smoothing_matches_the_spectrum_of_windowed_noise(rng):
    """A rough field's expected periodogram is r*r smoothed: checked against brute-force speckle of a bar."""
    size, bar = 128, 7.0
    offset = np.arange(-(size - 1), size)
    covariance = (bar * np.sinc(bar * offset / size)) ** 2 * (1 - np.abs(offset) / size)
    periodogram = np.array([(covariance * np.cos(2 * np.pi * lag * offset / size)).sum() / size for lag in range(12)])
    cells = 8
    albedo = np.zeros((64 * cells, 64 * cells))
    albedo[:, : int(bar * cells)] = 1.0
    rows = autocorrelate(albedo)[64 * cells - 1] / (64 * cells * cells)
    smoothed = smooth_by_window(np.outer(np.eye(1023)[511], rows), cells)
    smoothed /= smoothed[LAGS, LAGS] / periodogram[0]
    np.testing.assert_allclose(smoothed[LAGS, LAGS : LAGS + 12], periodogram, rtol=2e-3, atol=2e-3 * periodogram[0])


@pytest.mark.parametrize("cells", [1, 4])
def test_window_smoothing_keeps_the_level(cells):
    flat = np.ones((255 * cells, 255 * cells) if cells % 2 else (255 * cells + 1,) * 2)
    # what the sinc^2 tails beyond 127 lags would add is left
    assert smooth_by_window(flat, cells)[LAGS, LAGS] == pytest.approx(1.0, abs=0.005)


def test_peak_of_cell_means_restores_the_cusp():
    fine = np.zeros((64 * 16, 64 * 16))
    fine[203:603, 310:379] = 1.0
    fine[203:262, 310:557] = 1.0
    means = fine.reshape(64, 16, 64, 16).mean((1, 3))
    true_peak = (fine**2).sum() / 256
    assert peak_of_cell_means(autocorrelate(means)) == pytest.approx(true_peak, rel=0.05)
    assert (means**2).sum() < 0.92 * true_peak
