"""Phase retrieval on noise-free and noisy moduli made without the method's own code."""

import numpy as np
import pytest
import torch

from correlograph.lags import LAGS, lag_grid
from invert.albedo.metrics import aligned_pearson
from invert.choices import BALANCED, CLASSICAL, FAST
from invert.measure.spectrum import fourier_modulus, read_measurement
from invert.methods import reconstructor
from invert.solvers.base import PhaseProblem, modulus_residual, solve, to_modulus
from invert.solvers.hio import Hio
from radiometry.autocorrelation import autocorrelate, smooth_by_window

GRID = lag_grid(LAGS).padded_side

HALF_PLANE = lag_grid(LAGS).half_plane


def stroke_object(rng: np.random.Generator) -> np.ndarray:
    """Three connected thick strokes of unequal brightness inside 34 x 34 cells."""
    image = np.zeros((64, 64), np.float32)
    point = rng.integers(20, 44, 2)
    for _ in range(3):
        target = rng.integers(16, 48, 2)
        for t in np.linspace(0.0, 1.0, 80):
            r, c = np.round(point + t * (target - point)).astype(int)
            image[r - 1 : r + 2, c - 1 : c + 2] = np.maximum(image[r - 1 : r + 2, c - 1 : c + 2], rng.uniform(0.7, 1.0))
        point = target
    return image


def exact_modulus(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.abs(np.fft.rfft2(image, s=(GRID, GRID))).astype(np.float32))


def test_projection_has_the_modulus_and_fixes_solutions(rng):
    image = torch.from_numpy(np.pad(stroke_object(rng), (0, 64)))
    modulus = exact_modulus(image.numpy()[:64, :64])
    other = to_modulus(torch.rand(GRID, GRID, generator=torch.Generator().manual_seed(1)), modulus)
    np.testing.assert_allclose(torch.fft.rfft2(other).abs(), modulus, atol=1e-4 * float(modulus.max()))
    np.testing.assert_allclose(to_modulus(image, modulus), image, atol=1e-5)
    assert float(modulus_residual(image, modulus)) < 1e-10


@pytest.mark.slow
def test_noise_free_objects_are_found():
    rng = np.random.default_rng(3)
    images = [stroke_object(rng) for _ in range(4)]
    moduli = torch.stack([exact_modulus(image) for image in images])
    found = solve(Hio(starts=8), PhaseProblem(moduli, 40), torch.Generator().manual_seed(0))
    best = found.residual.argmin(-1)
    for index, image in enumerate(images):
        result = found.images[index, best[index]]
        result = torch.roll(result, (32, 32), (0, 1)).numpy()
        assert max(aligned_pearson(np.roll(result, s, (0, 1))[:64, :64], image)[0] for s in ((0, 0), (-32, -32))) > 0.97


def test_starts_take_turns_at_thresholds(rng):
    modulus = exact_modulus(stroke_object(rng))

    def images(*thresholds: float) -> torch.Tensor:
        solver = Hio(iterations=450, starts=3, shrink_threshold=thresholds)
        return solve(solver, PhaseProblem(modulus, 40), torch.Generator().manual_seed(0)).images

    low, high, both = images(0.03), images(0.3), images(0.03, 0.3)
    torch.testing.assert_close(both, torch.stack((low[0], high[1], low[2])))
    assert not torch.allclose(low[1], high[1])


def measured_from(image: np.ndarray, floor: float, dof: float, rng) -> np.ndarray:
    lags = autocorrelate(image)
    mean = smooth_by_window(lags) / lags.max() + floor
    noise = rng.gamma(dof, 1.0 / dof, mean.shape)
    return (mean * np.where(HALF_PLANE, noise, noise[::-1, ::-1])).astype(np.float32)


@pytest.mark.parametrize(("floor", "dof", "wanted"), [(0.01, 1e5, 0.93), (0.05, 64.0, 0.8)])
def test_a_noisy_f_is_recovered_and_not_mirrored(rng, floor, dof, wanted):
    image = np.zeros((64, 64), np.float32)
    image[14:48, 20:25], image[14:19, 20:42], image[28:33, 20:37] = 1.0, 1.0, 1.0
    result = reconstructor(CLASSICAL, BALANCED).run(read_measurement(measured_from(image, floor, dof, rng)))
    assert result.object_found
    pearson, _ = aligned_pearson(result.albedo, image)
    assert pearson > wanted
    assert aligned_pearson(result.albedo[:, ::-1], image)[0] < pearson - 0.1


def test_scale_does_not_matter(rng):
    estimate = measured_from(stroke_object(rng), 0.05, 64.0, rng)
    reference = fourier_modulus(read_measurement(estimate))
    for scale in (1e-20, 1e20):
        np.testing.assert_allclose(fourier_modulus(read_measurement(estimate * np.float32(scale))), reference, atol=2e-3)


def white(rng) -> np.ndarray:
    noise = rng.gamma(64.0, 1 / 64.0, (127, 127)).astype(np.float32)
    return np.where(HALF_PLANE, noise, noise[::-1, ::-1])


@pytest.mark.parametrize("kind", ["zero", "white", "row line", "column line"])
def test_noise_alone_is_no_object(rng, kind):
    estimate = np.zeros((127, 127), np.float32)
    if kind != "zero":
        estimate += white(rng)
        estimate[LAGS, LAGS] = 9.0
    if kind == "row line":
        estimate[LAGS] *= 5.0
    if kind == "column line":
        estimate[:, LAGS] *= 5.0
    measurement = read_measurement(estimate)
    result = reconstructor(CLASSICAL, FAST).run(measurement)
    assert not result.object_found
    assert not result.albedo.any()
    assert (measurement.interpolated != ()) == ("line" in kind)


def test_white_noise_rarely_alarms(rng):
    assert max(read_measurement(white(rng)).detection for _ in range(200)) < 5.0
