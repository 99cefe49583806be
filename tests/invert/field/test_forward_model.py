"""Grids, Fourier transform and forward model agree with explicit sums, adjoints and finite differences."""

import numpy as np
import pytest
import torch
from scipy.stats import nbinom

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from invert.field.counts import FrameCounts
from invert.field.forward_model import ForwardModel, expected_counts, log_likelihood, power
from invert.field.grid import field_grid
from radiometry.transfer import amplitude_transfer

CAMERA = CameraMetadata(532e-9, 6.9e-6, 1.0, 0.05, 0.54)


@pytest.fixture
def grid():
    return field_grid((130, 171), (120, 104), ((10.0, 14.0), (21.0, 23.0)))


def complex_normal(shape, rng):
    parts = rng.standard_normal((2, *shape)).astype(np.float32)
    return torch.complex(*map(torch.from_numpy, parts))


def test_the_grid_holds_the_object_and_resolves_its_grains(grid):
    grains = np.array((120 / 11.0, 104 / 9.0))
    assert (grains / grid.binning >= 2.5).all()
    assert (grains / (np.array(grid.binning) + 1) < 2.5).all()
    last = [positions[-1] for positions in grid.lag_positions()]
    assert last[0] >= 21.0
    assert last[1] >= 23.0
    assert grid.frame_shape == (130 // grid.binning[0], 171 // grid.binning[1])
    assert all(2 * box < side * 1.01 for box, side in zip(grid.box_shape, grid.shape, strict=True))  # no aliasing of |U|^2


def test_the_transform_is_the_explicit_sum_in_lags(grid, rng):
    """A pixel of the frame at n binned pixels sees a scatterer at k lags with the phase -2 pi n binning k / patch."""
    field = complex_normal(grid.box_shape, rng)
    wall = grid.to_wall(field)
    for row, column in ((0, 0), (3, 17), (40, 2)):
        phase = [
            n * bins * (positions - origin) / patch
            for n, bins, positions, origin, patch in zip(
                (row, column), grid.binning, grid.lag_positions(), grid.origin_lags, (120, 104), strict=True
            )
        ]
        terms = np.exp(-2j * np.pi * (phase[0][:, None] + phase[1][None]))
        explicit = (field.numpy() * terms).sum() / np.sqrt(grid.shape[0] * grid.shape[1])
        assert wall[row, column].item() == pytest.approx(explicit, abs=2e-5)


def test_transform_and_adjoint(grid, rng):
    field, wall = complex_normal(grid.box_shape, rng), complex_normal(grid.shape, rng)
    left = (grid.to_wall(field).conj() * wall).sum()
    right = (field.conj() * grid.to_object(wall)).sum()
    assert complex(left) == pytest.approx(complex(right), rel=1e-4)
    assert float(power(grid.to_wall(field)).sum()) == pytest.approx(float(power(field).sum()), rel=1e-5)


def test_binning_sums_pixels_and_its_transfer_is_that_of_a_wide_pixel(grid):
    frame = np.arange(130 * 171, dtype=np.float32).reshape(130, 171)
    down, right = grid.binning
    assert float(grid.bin(frame)[2, 1]) == pytest.approx(frame[2 * down : 3 * down, right : 2 * right].sum())
    row = np.fft.fftfreq(grid.shape[0], down)[:, None] / CAMERA.pixel_pitch_m
    column = np.fft.rfftfreq(grid.shape[1], right)[None] / CAMERA.pixel_pitch_m
    wide = amplitude_transfer(row, column, CAMERA.pixel_pitch_m, 0.05, 532e-9, 0.54)
    for one, count in ((row, down), (column, right)):
        small = one * CAMERA.pixel_pitch_m
        wide = wide * np.sinc(count * small) / np.sinc(small)
    assert grid.transfer(CAMERA, (0.0, 0.0)).numpy() == pytest.approx(wide, abs=1e-6)
    blurred = grid.transfer(CAMERA, (1.5, 0.0)).numpy()
    assert blurred[5, 7] / wide[5, 7] == pytest.approx(
        np.exp(-2.0 * (np.pi * 1.5 * np.fft.fftfreq(grid.shape[0], down)[5]) ** 2)
    )


def test_grains_below_two_pixels_are_refused():
    with pytest.raises(InputError, match="grains of at least 2 pixels"):
        field_grid((256, 256), (128, 128), ((0.0, 0.0), (70.0, 30.0)))


def test_counts_of_a_rough_wall_are_negative_binomial(rng):
    """Poisson counts of Gamma-distributed light (mean 3, relative variance 0.4): the likelihood has its maximum at the mean, and its
    differences are those of the distribution."""
    roughness, mean = 0.4, 3.0
    counts = torch.arange(40.0, dtype=torch.float64)
    one, other = (
        log_likelihood(counts, torch.full_like(counts, level), roughness)
        - torch.from_numpy(nbinom.logpmf(counts.numpy(), 1.0 / roughness, 1.0 / (1.0 + roughness * level)))
        for level in (mean, 1.7)
    )
    assert one.numpy() == pytest.approx(other.numpy(), abs=1e-9)
    limit = log_likelihood(counts, torch.full_like(counts, mean), 1e-7)
    assert limit.numpy() == pytest.approx(log_likelihood(counts, torch.full_like(counts, mean), 0.0).numpy(), abs=1e-3)


def make_counts(grid, rng, background=0.3, roughness=0.0):
    values = torch.from_numpy(rng.poisson(2.0, grid.frame_shape).astype(np.float32))
    fitted = torch.from_numpy(rng.random(grid.frame_shape) > 0.1)
    lit = torch.from_numpy(np.linspace(0.5, 1.5, grid.frame_shape[1], dtype=np.float32)).expand(grid.frame_shape)
    return FrameCounts(values, values, fitted, ~fitted, lit, background, 2.0 - background, roughness)


@pytest.mark.parametrize(("modes", "roughness"), [(1, 0.0), (2, 0.0), (1, 0.4)])
def test_gradient_is_the_derivative_of_the_likelihood(grid, rng, modes, roughness):
    model, counts = ForwardModel(grid, grid.transfer(CAMERA, (0.0, 0.0))), make_counts(grid, rng, roughness=roughness)
    field, direction = (complex_normal((modes, *grid.box_shape), rng) * scale for scale in (3.0, 1.0))

    def deficit(one):
        expected = expected_counts(model.intensity(grid.to_wall(one)), counts)
        return -float((counts.fitted * log_likelihood(counts.values, expected, roughness)).sum(dtype=torch.float64))

    wall = grid.to_wall(field)
    expected = expected_counts(model.intensity(wall), counts)
    residual = counts.fitted * counts.illumination * (1.0 - counts.values / expected) / (1.0 + roughness * expected)
    gradient = model.gradient(residual, wall)
    step = 2e-2
    numerical = (deficit(field + step * direction) - deficit(field - step * direction)) / (2.0 * step)
    assert 2.0 * float((gradient.conj() * direction).real.sum()) == pytest.approx(numerical, rel=2e-2)
