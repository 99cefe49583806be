"""Faults of cameras and lamps: found, replaced or subtracted, and nothing found where there is none."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import autocorrelate, patch_grid, smooth_by_window
from radiometry.estimation.autocorrelation_estimator import AutocorrelationEstimator, estimate_autocorrelation
from radiometry.estimation.illumination import flatten_illumination, is_uneven
from radiometry.estimation.pixel_faults import repair
from radiometry.estimation.spectral_lines import find_lines, subtract_waves
from tests.light import speckle, wall_texture

RING = lag_grid(LAGS).ring

PATCH = 131
SHAPE = (5 * PATCH, 6 * PATCH)


def frame_of_a_bar(rng: np.random.Generator, shape: tuple[int, int] = SHAPE, photons: float = 3.0) -> np.ndarray:
    """Counted speckle of a rectangle of 9 x 21 lags, cropped from a wider period."""
    rows, columns = shape[0] + 100, shape[1] + 100
    lag_rows, lag_columns = np.fft.fftfreq(rows) * PATCH, np.fft.fftfreq(columns) * PATCH
    bar = 1.0 * ((np.abs(lag_rows)[:, None] < 4.5) & (np.abs(lag_columns) < 10.5))
    return rng.poisson(photons * speckle(bar, bar.shape, rng)[: shape[0], : shape[1]]).astype(np.float32)


@pytest.mark.parametrize("photons", [0.01, 0.3, 30.0])
def test_whole_pixels_are_left_alone(rng, photons):
    frame = torch.from_numpy(frame_of_a_bar(rng, photons=photons))
    repaired, faults = repair(frame)
    assert (faults.hot_pixels, faults.lines) == (0, 0)
    assert torch.equal(repaired, frame)


def test_hot_pixels_are_found_and_replaced(rng):
    frame = frame_of_a_bar(rng)
    where = rng.random(SHAPE) < 1e-4
    hot = np.where(where, 300.0, frame).astype(np.float32)
    repaired, faults = repair(torch.from_numpy(hot))
    assert faults.hot_pixels == where.sum()
    assert (repaired.numpy()[~where] == frame[~where]).all()
    assert repaired.numpy()[where].max() < 30.0


def test_wide_grains_have_no_faulty_lines(rng):
    """Means of lines follow one another so smoothly there that the median of nine is often the middle one."""
    for axis in (0, 1):
        wide = gaussian_filter(rng.standard_normal(SHAPE), [12.0 if axis == number else 2.0 for number in (0, 1)])
        light = (wide / wide.std()).astype(np.float32) ** 2
        assert repair(torch.from_numpy(light))[1].lines == 0


@pytest.mark.parametrize("value", [0.0, 40.0])
def test_dead_and_hot_lines_are_found(rng, value):
    frame = frame_of_a_bar(rng)
    frame[200], frame[:, 333] = value, value
    repaired, faults = repair(torch.from_numpy(frame))
    assert faults.lines == 2
    assert abs(repaired.numpy()[200].mean() / 3.0 - 1.0) < 0.3
    assert abs(repaired.numpy()[:, 333].mean() / 3.0 - 1.0) < 0.3


def test_a_glint_is_taken_out_with_its_margin_and_a_hot_line_is_not_one(rng):
    frame = frame_of_a_bar(rng)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    glint = 900.0 * np.exp(-((row - 170.0) ** 2 + (column - 400.0) ** 2) / 18.0)
    repaired, faults = repair(torch.from_numpy((frame + glint).astype(np.float32)))
    assert faults.hot_pixels > 9
    changed = np.abs(repaired.numpy() - frame)
    assert changed[glint > 1.0].max() < frame.max()
    assert (changed[np.hypot(row - 170.0, column - 400.0) > 25.0] < 1e-6).all()
    frame[200] = 900.0
    repaired, faults = repair(torch.from_numpy(frame))
    assert (repaired.numpy() == frame)[np.abs(row - 200) > 2].all()


def test_saturation_is_seen(rng):
    frame = frame_of_a_bar(rng, photons=100.0)
    assert repair(torch.from_numpy(frame))[1].saturated < 1e-4
    limit = np.quantile(frame, 0.97)
    assert repair(torch.from_numpy(np.minimum(frame, limit)))[1].saturated == pytest.approx(0.03, abs=0.003)


FALL = {
    "Gaussian": lambda row, column: np.exp(-14.0 * (row**2 + 0.6 * (column + 0.1) ** 2)),
    "corner": lambda row, column: np.exp(-6.0 * ((row - 0.3) ** 2 + (column + 0.2) ** 2)),
    "vignetting": lambda row, column: np.cos(np.arctan(1.2 * np.hypot(row, column))) ** 4,
    "gradient": lambda row, column: 1.0 + 1.6 * row,
}


@pytest.mark.parametrize("kind", FALL)
@pytest.mark.parametrize("photons", [0.4, 30.0])
def test_illumination_is_divided_out(rng, kind, photons):
    """Speckle under an uneven illumination: its mean becomes even, and its lags those of speckle under an even one."""
    row, column = (np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5) / np.array(SHAPE)[:, None, None] - 0.5
    fall = FALL[kind](row, column)
    light = frame_of_a_bar(rng, photons=1e4) / 1e4
    frame = torch.from_numpy(rng.poisson(photons * light * fall).astype(np.float32))
    assert is_uneven(frame, (PATCH, PATCH))
    flat = flatten_illumination(frame, (PATCH, PATCH))
    blocks = flat.reshape(5, PATCH, 6, PATCH).mean((1, 3)) / flat.mean()
    assert abs(blocks - 1.0).max() < 0.2
    lags, even = (estimate_autocorrelation([frame], patch_grid(SHAPE, PATCH), "pooled")[0] for frame in (flat.numpy(), light))
    signal = np.zeros((127, 127), bool)
    signal[55:72, 44:83] = True
    signal[63, 63] = False
    assert np.corrcoef(lags[signal], even[signal])[0, 1] > 0.96


def test_frames_of_many_patches_and_negative_light(rng):
    """The polynomial's zeros are few enough for its blocks; light that a dark frame made negative is left as it is."""
    row, column = (np.mgrid[:1500, :6000] + 0.5) / np.array((1500, 6000))[:, None, None] - 0.5
    fall = FALL["vignetting"](row, column) * 100.0
    frame = torch.from_numpy(rng.poisson(fall).astype(np.float32))
    assert is_uneven(frame, (128, 128))
    flat = flatten_illumination(frame, (128, 128))
    assert float(flat.mean()) == pytest.approx(fall.mean(), rel=1e-3)
    assert float(abs(torch.nn.functional.adaptive_avg_pool2d(flat[None], 32) / flat.mean() - 1.0).max()) < 0.1
    assert not is_uneven(torch.from_numpy((fall - 0.8 * fall.mean()).astype(np.float32)), (128, 128))


def test_frames_of_one_capture_are_evened_out_alike(rng):
    """A textured wall whose slope is strong enough in one frame to be evened out, and not in the other."""
    wall = wall_texture(SHAPE, rng)
    row = np.mgrid[: SHAPE[0], : SHAPE[1]][0] / SHAPE[0] - 0.5
    counts = rng.poisson(10.0, (2, *SHAPE)) + 2.0 * wall

    def seen(slope: float) -> list[torch.Tensor]:
        sloping = [one + slope * share * row for one, share in zip(counts, (1.0, 0.9), strict=True)]
        return [torch.from_numpy(frame.astype(np.float32)) for frame in sloping]

    slope = next(
        slope for slope in np.arange(-30.0, 30.0, 0.1) if len({is_uneven(frame, (PATCH, PATCH)) for frame in seen(slope)}) == 2
    )
    estimate, _ = estimate_autocorrelation(seen(slope), patch_grid(SHAPE, PATCH))
    assert estimate[62, 63] < 30.0 * np.median(estimate)  # evened out one by one: some 400 times


def test_even_light_is_left_alone(rng):
    assert not is_uneven(torch.from_numpy(frame_of_a_bar(rng, photons=0.4)), (PATCH, PATCH))


def spectrum_power(frame: np.ndarray) -> torch.Tensor:
    padded = (SHAPE[0] + PATCH, SHAPE[1] + PATCH)
    return torch.fft.rfft2(torch.from_numpy(frame - frame.mean()), s=padded).abs().square()


PER_LAG = ((SHAPE[0] + PATCH) / PATCH, (SHAPE[1] + PATCH) / PATCH)


def test_speckle_has_no_lines(rng):
    for photons in (0.05, 3.0, 100.0):
        assert find_lines(spectrum_power(frame_of_a_bar(rng, photons=photons)), PER_LAG) == []


@pytest.mark.parametrize(("down", "right"), [(0.0213, 0.0371), (-0.1, 0.0452), (0.0, 0.031), (0.0291, 0.0)])
def test_waves_are_found_and_subtracted(rng, down, right):
    """Amplitude, phase and a frequency between those of the frame: what is left is the speckle, to a hundredth."""
    frame = frame_of_a_bar(rng, photons=30.0)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    wave = (30.0 * np.sin(2 * np.pi * (down * row + right * column) + 0.7)).astype(np.float32)
    lines = find_lines(spectrum_power(frame + wave), PER_LAG)
    assert len(lines) in (1, 2)
    padded = (SHAPE[0] + PATCH, SHAPE[1] + PATCH)
    left = subtract_waves(torch.from_numpy(frame + wave), lines, padded).numpy() - frame
    assert left.var() < 0.01 * wave.var()


def test_fringes_that_move_leave_the_estimate_as_it_is(rng):
    """Lags of two frames with fringes that move, over those without: the same to the estimate's own noise."""
    grid = patch_grid(SHAPE, PATCH)
    frames = [frame_of_a_bar(rng), frame_of_a_bar(rng)]
    column = np.arange(SHAPE[1])
    fringed = [frame + 0.6 * np.sin(2 * np.pi * 0.243 * column + 2.0 * n).astype(np.float32) for n, frame in enumerate(frames)]
    clean, _ = estimate_autocorrelation(frames, grid)
    found, dof = estimate_autocorrelation(fringed, grid)
    left = np.delete((found - clean) / clean, 63, axis=1)
    assert left.std() < 0.5 / np.sqrt(dof)
    assert abs(found / clean - 1.0).max() < 1.0
    plain, _ = estimate_autocorrelation(fringed, grid, "pooled")
    assert abs(plain / clean - 1.0).max() > 10.0


def textured(rng: np.random.Generator, power: np.ndarray) -> np.ndarray:
    """Light without a third moment, of the same power spectrum as a speckle frame."""
    drawn = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(SHAPE)) * np.sqrt(power), s=SHAPE)
    return drawn / drawn.std()


@pytest.mark.parametrize("photons", [1.0, 30.0])
def test_third_moment_tells_speckle_from_texture(rng, photons):
    """A rectangle's speckle has the third moment of its triple correlation; texture of the same spectrum has none."""
    albedo = np.zeros((64, 64), np.float32)
    albedo[28:37, 20:41] = 1.0
    weight = np.where((RING >= 2) & (RING < 24), 1.0, 0.0)
    grid = patch_grid(SHAPE, PATCH)
    frames = {"speckle": [frame_of_a_bar(rng, photons=photons) for _ in range(4)]}
    level = gaussian_filter(np.abs(np.fft.rfft2(frames["speckle"][0] - photons)) ** 2, 3)
    frames["texture"] = [
        rng.poisson(photons * np.clip(3.0 + 0.3 * textured(rng, level), 0.0, None)).astype(np.float32) for _ in range(4)
    ]
    found = {}
    for kind, group in frames.items():
        estimator = AutocorrelationEstimator(grid)
        for frame in group:
            estimator.add(frame)
        lags = estimator.estimate()
        floor = float(np.median(lags))
        signal = lags - floor
        known = smooth_by_window(autocorrelate(albedo))
        power = float((weight * signal).sum() / (weight * known).sum())
        found[kind] = estimator.filtered_frames().likeness(albedo, weight, np.ones_like(weight), signal, floor, power)
    ratio, error = found["speckle"]
    assert error < 0.15
    assert abs(ratio - 1.0) < 4.0 * error + 0.05
    ratio, error = found["texture"]
    assert abs(ratio) < 4.0 * error + 0.05


def test_independent_frames_show_no_shift(rng):
    """40 pairs of sizes and brightness at random; a false alarm in 1e4 is allowed for each."""
    for _ in range(40):
        shape = (int(rng.integers(200, 520)), int(rng.integers(200, 520)))
        estimator = AutocorrelationEstimator(patch_grid(shape, PATCH))
        photons = float(10.0 ** rng.uniform(-1.0, 2.0))
        for _ in range(2):
            estimator.add(torch.from_numpy(frame_of_a_bar(rng, shape, photons)))
        shift = estimator.background.shift_pixels or (0.0, 0.0)
        assert shift == (0.0, 0.0)


def test_dim_frames_are_not_saturated(rng):
    """Counts of few photoelectrons, of brightness at random. Clipped bright frames are saturated."""
    for photons in 10.0 ** rng.uniform(-2.0, 1.0, 30):
        frame = frame_of_a_bar(rng, photons=float(photons))
        assert repair(torch.from_numpy(frame))[1].saturated == 0.0
    frame = np.minimum(frame_of_a_bar(rng, photons=8.0), 20.0)
    assert repair(torch.from_numpy(frame))[1].saturated > 0.05


@pytest.mark.parametrize("read_noise", [0.03, 0.07, 0.12])
def test_single_photons_above_weak_read_noise_are_not_hot_pixels(rng, read_noise):
    """About one pixel in a thousand holds a photon, so that the quantile from which the tail is extrapolated is read noise."""
    for fraction in (3e-4, 9e-4, 1.1e-3, 3e-3):
        frame = rng.poisson(fraction, (900, 700)) + read_noise * rng.standard_normal((900, 700))
        assert repair(torch.from_numpy(frame.astype(np.float32)))[1].hot_pixels == 0


def test_hot_pixels_of_many_values_and_saturated_ones_are_replaced(rng):
    for values in (rng.uniform(300.0, 4000.0, 400), np.full(400, 4095.0)):
        frame = rng.exponential(5.0, (900, 700)).astype(np.float32)
        places = rng.choice(frame.size, 400, replace=False)
        frame.ravel()[places] = values
        repaired, faults = repair(torch.from_numpy(frame))
        assert faults.hot_pixels == 400
        assert float(repaired.max()) < 120.0
