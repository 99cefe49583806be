"""Fractions of pixels that saturate, against closed forms and drawn pixels."""

import numpy as np
import pytest

from radiometry.sensor.chain import expose
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.saturation import counting_fraction, saturated_fraction
from radiometry.sensor.stage import SpeckleLight


@pytest.mark.parametrize(("mean", "full_well"), [(0.088, 1.0), (3.0, 5.0), (40.0, 60.0)])
def test_counts_of_developed_speckle_are_bose_einstein(mean, full_well):
    found = saturated_fraction(SpeckleLight(mean, 9.0), Electronics(1.0, full_well=full_well))
    assert found == pytest.approx((mean / (1.0 + mean)) ** full_well, rel=0.01)


def test_dark_current_and_lamps_fill_the_well():
    electronics = Electronics(2.0, full_well=1000.0, dark_current=300.0)
    light = SpeckleLight(5.0, 9.0, ambient=100.0, stray=60.0)
    assert saturated_fraction(light, electronics) < 1e-3
    assert saturated_fraction(SpeckleLight(5.0, 9.0, ambient=500.0), electronics) > 0.99


@pytest.mark.parametrize(
    "values",
    [
        {"full_well": 30.0, "read_noise": 4.0},
        {"full_well": 31.0, "bits": 4},
        {"bits": 5, "gain": 1.5, "dark_current": 8.0},
        {"full_well": 200.0, "shot_noise": False},
        {"full_well": 14.0, "gate": 0.05},
    ],
)
@pytest.mark.parametrize("modes", [1.0, 2.0])
def test_the_forecast_is_the_fraction_of_drawn_pixels(rng, values, modes):
    electronics, light = Electronics(1.0, **values), SpeckleLight(17.0, 9.0, ambient=2.0, modes=modes)
    expected = light.ambient + rng.gamma(modes, light.signal / modes, (700, 900))
    frame = expose(expected.astype(np.float32), electronics, rng)
    drawn = float((frame >= electronics.ceiling * (1.0 - 1e-6)).mean())
    assert saturated_fraction(light, electronics) == pytest.approx(drawn, rel=0.06, abs=2e-4)


def test_gates_count_one_photon_each():
    electronics = Electronics(1.0, gate=0.01)
    expected = 1.0 - np.exp(-0.2) / (1.0 + 0.5)  # Laplace transform of exponential light, times that of the constant
    assert counting_fraction(SpeckleLight(50.0, 9.0, stray=20.0), electronics) == pytest.approx(expected, rel=1e-3)
    assert counting_fraction(SpeckleLight(50.0, 9.0), Electronics(1.0)) == 0.0
