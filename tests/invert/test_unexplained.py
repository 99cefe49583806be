"""Signal that a reconstruction leaves unexplained, with its threshold."""

import numpy as np
import pytest
import torch

from invert.assess.speckle_test import ALLOWED_UNEXPLAINED_FRACTION, unexplained_fraction
from invert.measure.spectrum import Measurement, read_measurement
from radiometry.autocorrelation import autocorrelate, smooth_by_window
from radiometry.noise.model import draw_estimate
from tests.light import letter_cells


def _expected(albedo: np.ndarray) -> np.ndarray:
    signal = smooth_by_window(autocorrelate(albedo))
    return signal / signal.max()


def _measure(signal: np.ndarray, floor: float, dof: float, seed: int) -> tuple[Measurement, np.ndarray, np.ndarray]:
    """Return a measurement of a simulated estimate, its signal, and the mask of the lags that count."""
    spectrum = torch.from_numpy(signal + floor)
    drawn = draw_estimate(spectrum, dof, torch.Generator().manual_seed(seed), correlated=True).numpy().astype(np.float32)
    measurement = read_measurement(drawn)
    rings = measurement.lag_grid.ring
    return measurement, drawn - measurement.noise.floor, (measurement.noise.signal_ring >= rings) & (rings > 1)


@pytest.mark.parametrize(("floor", "dof"), [(0.1, 30.0), (1.0, 60.0), (3.0, 300.0)])
def test_the_true_object_is_rarely_found_to_explain_too_little(floor, dof):
    truth = _expected(letter_cells("F"))
    found = []
    for seed in range(200):
        measurement, signal, used = _measure(truth, floor, dof, seed)
        found.append(unexplained_fraction(signal, truth, measurement, used))
    value, threshold = np.array(found).T
    assert not (value > threshold).any()
    by_chance = np.sqrt(threshold**2 - ALLOWED_UNEXPLAINED_FRACTION**2)
    assert np.mean(value > by_chance) < 0.05  # 0.2 % by design; the noise level is itself measured


def test_another_object_is_found_to_explain_too_little():
    truth, other = _expected(letter_cells("F")), _expected(letter_cells("5"))
    known = float(np.sqrt(1.0 - (truth * other).sum() ** 2 / (truth**2).sum() / (other**2).sum()))
    measurement, signal, used = _measure(truth, 0.1, 400.0, 1)
    fraction, threshold = unexplained_fraction(signal, other, measurement, used)
    assert fraction == pytest.approx(known, abs=0.15)
    assert ALLOWED_UNEXPLAINED_FRACTION < threshold < fraction
    assert fraction**2 - (threshold**2 - ALLOWED_UNEXPLAINED_FRACTION**2) > (0.7 * fraction) ** 2  # hardly any by chance
