"""Floor and degrees of freedom read back from synthetic estimates."""

from types import SimpleNamespace

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.exposure_planner import measured_error
from radiometry.noise.measured_noise import ASSUMED_DOF, extrapolated_peak, fit_known_signal, read_noise_level

HALF_PLANE = lag_grid(LAGS).half_plane


def albedo() -> np.ndarray:
    image = np.zeros((64, 64))
    image[14:47, 20:25] = 1.0
    image[14:19, 20:42] = 1.0
    image[28:33, 20:36] = 0.6
    return image


def gamma_estimate(rng, floor: float, dof: float) -> np.ndarray:
    """Centro-symmetric Gamma noise around the window-smoothed r*r of `albedo`, peak scaled to 1."""
    lags = autocorrelate(albedo())
    mean = smooth_by_window(lags) / lags.max() + floor
    noise = rng.gamma(dof, 1.0 / dof, mean.shape)
    return (mean * np.where(HALF_PLANE, noise, noise[::-1, ::-1])).astype(np.float32)


@pytest.mark.parametrize(("floor", "dof"), [(0.005, 64.0), (0.05, 64.0), (0.5, 16.0), (3.0, 64.0), (0.2, 1.0), (0.1, 1000.0)])
def test_floor_and_dof_are_read_back(rng, floor, dof):
    noise = read_noise_level(gamma_estimate(rng, floor, dof))
    assert noise.floor == pytest.approx(floor, rel=0.02 + 0.1 / np.sqrt(dof))
    assert noise.dof == pytest.approx(dof, rel=0.1)


@pytest.mark.parametrize("floor", [0.005, 0.05, 0.3, 2.5])
def test_a_known_signal_gives_the_gain_whatever_the_floor(rng, floor):
    estimate = gamma_estimate(rng, floor, 64.0)
    lags = autocorrelate(albedo())
    gain, fitted = fit_known_signal(estimate, smooth_by_window(lags))
    assert fitted == pytest.approx(floor, rel=0.02)
    assert gain * lags.max() == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("floor", [1e-5, 0.2])
def test_the_error_against_a_known_signal_is_that_of_the_noise(rng, floor):
    """Lags without signal have little noise in bright frames; the gain must not follow them."""
    lags = autocorrelate(albedo())
    signal = smooth_by_window(lags) / lags.max()
    known = SimpleNamespace(signal=signal, grid=SimpleNamespace(lag_grid=lag_grid(LAGS)))
    errors = [measured_error(gamma_estimate(rng, floor, 20.0), known) for _ in range(12)]
    expected = np.linalg.norm((signal + floor)[HALF_PLANE]) / np.linalg.norm(signal[HALF_PLANE]) / np.sqrt(20.0)
    assert np.mean(errors) == pytest.approx(expected, rel=0.05)
    with pytest.raises(InputError, match="photoelectrons"):
        measured_error(np.zeros((127, 127)), known)


def test_quantisation_is_taken_out(rng):
    picture = np.round(20.0 * rng.gamma(700.0, 1 / 700.0, (127, 127)))
    assert read_noise_level(picture, 1.0).dof == pytest.approx(700.0, rel=0.15)
    assert read_noise_level(picture, 0.0).dof < 650.0


def test_no_noise_reads_no_dof():
    flat = np.full((127, 127), 0.25, np.float32)
    noise = read_noise_level(flat)
    assert noise.floor == pytest.approx(0.25)
    assert noise.dof is None
    assert read_noise_level(np.zeros((127, 127), np.float32)).floor == 0.0


def test_the_peak_is_extrapolated_without_zero_lag(rng):
    lags = autocorrelate(albedo())
    estimate = (lags / lags.max() + 0.1).astype(np.float32)
    noise = read_noise_level(estimate)
    estimate[LAGS, LAGS] = 77.0
    assert extrapolated_peak(estimate, noise)[0] == pytest.approx(1.0, rel=0.1)


def test_the_peaks_error_is_its_scatter(rng):
    peaks, errors = np.transpose(
        [extrapolated_peak(e, read_noise_level(e)) for e in (gamma_estimate(rng, 0.1, 64.0) for _ in range(60))]
    )
    assert peaks.mean() == pytest.approx(1.0, rel=0.1)
    assert errors.mean() == pytest.approx(peaks.std(), rel=0.35)


@pytest.mark.parametrize("floor", [0.3, 1.0])
def test_noise_hidden_by_rounding_gives_assumed_dof(rng, floor):
    """Floors of one grey level or less hide K, which is then assumed instead of infinite."""
    lags = smooth_by_window(autocorrelate(np.pad(np.ones((9, 23)), ((20, 35), (10, 31)))))
    picture = np.round(254.0 * lags / lags.max() + floor * rng.gamma(64.0, 1 / 64.0, lags.shape))
    noise = read_noise_level(picture, 1.0)
    assert (noise.dof, noise.dof_read) == (ASSUMED_DOF, False)
    assert read_noise_level(picture, 0.0).dof_read
