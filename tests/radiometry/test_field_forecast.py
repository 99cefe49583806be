"""Forecast of fields: closed forms of the photons per grain and of the cells."""

import numpy as np
import pytest

from radiometry.field_forecast import BOX_MARGIN_LAGS, MIN_PHOTONS_PER_GRAIN, forecast_fields

SHAPE, PATCH = (1024, 1280), (256, 256)

MARGINS = 2.0 * BOX_MARGIN_LAGS - 1.0
"""Both margins of a box, from the first to the last pixel's centre."""


def rectangle(rows, columns):
    albedo = np.zeros((64, 64))
    albedo[5 : 5 + rows, 9 : 9 + columns] = 0.7
    return albedo


def test_photons_per_grain_of_an_object_that_fills_its_box():
    """The coherence area without the margin is a grain of the box, and floor over peak is one over its photons."""
    found = forecast_fields(rectangle(20, 31), 0.05, 3, SHAPE, PATCH, (300e-6, 290e-6))
    assert found.photons_per_grain == pytest.approx(20.0 * 20.0 * 31.0 / ((20.0 + MARGINS) * (31.0 + MARGINS)))
    assert found.looks == 3
    assert found.suffices


def test_photons_per_grain_falls_with_the_filled_fraction():
    albedo = rectangle(20, 20)
    albedo[5:25, 10:28] = 0.0
    filled = albedo.astype(bool).sum() / (20.0 + MARGINS) ** 2
    found = forecast_fields(albedo, 0.05, 2, SHAPE, PATCH)
    assert found.photons_per_grain == pytest.approx(20.0 * filled)
    assert found.suffices == (20.0 * filled >= MIN_PHOTONS_PER_GRAIN)
    assert found.cells_m is None


def test_cells_are_lambda_z_over_the_frame():
    """A lag is lambda z over the patch."""
    found = forecast_fields(rectangle(20, 31), 0.05, 3, SHAPE, PATCH, (300e-6, 290e-6))
    assert found.cells_m == pytest.approx((300e-6 * 256 / 1024, 290e-6 * 256 / 1280))
    twice = forecast_fields(rectangle(20, 31), 0.05, 6, SHAPE, PATCH)
    assert twice.cpu_s == pytest.approx(2.0 * found.cpu_s)


def test_no_light_has_no_forecast():
    assert forecast_fields(np.zeros((64, 64)), 0.05, 2, SHAPE, PATCH) is None
    assert forecast_fields(rectangle(4, 4), 0.05, 2, SHAPE, (10, 10)) is None  # grains of less than two camera pixels
    assert forecast_fields(rectangle(4, 4), None, 2, SHAPE, PATCH) is None
