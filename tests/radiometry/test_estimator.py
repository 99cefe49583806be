"""The estimator from whole frames: against sums over pairs of pixels, its K and correlations by theory, and its mean model."""

import math

import numpy as np
import pytest
import torch

from correlograph.errors import InputError
from correlograph.lags import LAGS, lag_grid
from radiometry.autocorrelation import patch_grid
from radiometry.estimation.autocorrelation_estimator import (
    AutocorrelationEstimator,
    degrees_of_freedom,
    estimate_autocorrelation,
)
from radiometry.noise.measured_noise import read_noise_level
from radiometry.noise.model import lag_correlation
from tests.light import speckle

OFF_AXIS = lag_grid(LAGS).off_axis
RING = lag_grid(LAGS).ring

SHAPE, SIZE = (640, 777), (130, 141)


def estimator_of(frames, size=SIZE, mean="auto") -> tuple[np.ndarray, AutocorrelationEstimator]:
    estimator = AutocorrelationEstimator(patch_grid(frames[0].shape, size), mean=mean)
    for frame in frames:
        estimator.add(frame)
    return estimator.estimate(), estimator


def grains(rng, count: int, shape=SHAPE, photons: float = 2.0) -> list[np.ndarray]:
    """Frames of grains three pixels wide, new in each, with shot noise; contrast 1."""
    frames = []
    for _ in range(count):
        row, column = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None]
        pupil = 1.0 * ((np.abs(row) < 0.15) & (np.abs(column + 0.02) < 0.12))
        frames.append(rng.poisson(photons * speckle(pupil, shape, rng)).astype(np.float32))
    return frames


@pytest.mark.parametrize("lag", [(0, 1), (4, -9), (-63, 20), (63, 63)])
def test_it_is_the_sum_over_pairs_of_pixels(rng, lag):
    """sum over d of w(d) c(d) exp(-2 pi i k d / P), c the mean over all pairs of pixels d apart."""
    shape, size = (150, 171), (129, 127)
    frame = rng.gamma(2.0, 3.0, shape)
    estimate, _ = estimator_of([frame, frame[::-1].copy()], size, "pooled")
    values = [image - image.mean() for image in (frame, frame[::-1])]
    expected = 0.0
    for down in range(1 - size[0], size[0]):
        wave = np.exp(-2j * np.pi * lag[0] * down / size[0]) * (1 - abs(down) / size[0]) / (shape[0] - abs(down))
        for image in values:
            upper, lower = image[max(down, 0) :][: shape[0] - abs(down)], image[max(-down, 0) :][: shape[0] - abs(down)]
            cross = np.fft.ifft((np.fft.fft(upper, 512) * np.fft.fft(lower, 512).conj()).sum(0)).real
            right = np.arange(1 - size[1], size[1])
            weight = (1 - np.abs(right) / size[1]) / (shape[1] - np.abs(right))
            expected += (wave * (cross[right % 512] * weight * np.exp(-2j * np.pi * lag[1] * right / size[1])).sum()).real / 2
    assert estimate[LAGS + lag[0], LAGS + lag[1]] == pytest.approx(expected, rel=1e-3, abs=1e-4 * float(estimate.max()))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_k_and_the_correlation_of_lags_are_those_of_theory(rng, count):
    frames = [rng.poisson(3.0, SHAPE) for _ in range(count)]
    estimate, estimator = estimator_of(frames)
    assert estimator.dof == pytest.approx(count * degrees_of_freedom(1, SHAPE, SIZE))
    free = OFF_AXIS & (RING > 3)
    assert estimate[free].mean() == pytest.approx(3.0, rel=0.01)
    assert estimate[free].mean() ** 2 / estimate[free].var() == pytest.approx(estimator.dof, rel=0.06)
    noise = estimate - 3.0
    noise[LAGS] = noise[:, LAGS] = 0.0
    for apart in (1, 2):
        for view in (noise[LAGS + 2 :], noise.T[LAGS + 2 :]):
            correlation = (view[:, apart:] * view[:, :-apart]).mean() / (view**2).mean()
            assert correlation == pytest.approx(float(lag_correlation(np.array(apart))), abs=0.05)
    assert read_noise_level(estimate).inflation == pytest.approx(2.25, rel=0.2)


def test_many_patches_give_nine_quarters_of_their_number_and_one_gives_one():
    assert degrees_of_freedom(1, (20000, 20000), (200, 200)) == pytest.approx(2.25 * 1e4, rel=0.02)
    assert degrees_of_freedom(2, (200, 300), (200, 300)) == pytest.approx(2.0)
    assert degrees_of_freedom(2, (2056, 2464), (257, 257)) > 300


def test_the_expectation_is_that_of_patches_side_by_side(rng):
    frames = grains(rng, 12)
    ours, _ = estimator_of(frames)
    published, dof = estimate_autocorrelation(frames, patch_grid(SHAPE, SIZE), "published")
    held = RING > 1
    ratio = ours[held] / published[held]
    assert ratio.mean() == pytest.approx(1.0, abs=4.0 / math.sqrt(dof) / 20)
    broad = [float(image[(r - 8 < RING) & (r >= RING) & held].mean()) for image in (ours, published) for r in (10, 20, 40)]
    np.testing.assert_allclose(broad[:3], broad[3:], rtol=0.05)


def test_speckle_that_is_new_in_each_frame_is_left_whole(rng):
    estimate, estimator = estimator_of(grains(rng, 2))
    assert estimator.background.fixed_pattern_lags == 0.0
    assert not estimator.background.uneven_illumination
    assert abs(estimator.background.frames_correlate) < 0.05
    np.testing.assert_array_equal(estimate, estimate[::-1, ::-1])


@pytest.mark.parametrize("kind", ["texture", "fringes", "texture and drift", "moved texture", "vignetting"])
def test_background_is_detected_and_subtracted(rng, kind):
    """Beside the same frames without it: the lags agree within their noise, where a pooled mean is many times off."""
    frames = grains(rng, 2, photons=20.0)
    clean, _ = estimator_of(frames)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    white = np.fft.rfft2(rng.standard_normal((SHAPE[0] + 8, SHAPE[1])))
    low = np.exp(-((np.fft.fftfreq(SHAPE[0] + 8)[:, None] / 0.08) ** 2) - (np.fft.rfftfreq(SHAPE[1])[None] / 0.05) ** 2)
    texture = np.fft.irfft2(white * low, s=(SHAPE[0] + 8, SHAPE[1]))
    texture *= 12.0 / texture.std()
    patterns = {
        "texture": [texture[4:-4]] * 2,
        "fringes": [15.0 * np.sin(2 * np.pi * (0.11 * row + 0.04 * column))] * 2,
        "texture and drift": [40.0 + texture[4:-4], 1.08 * (40.0 + texture[4:-4])],
        "moved texture": [texture[4:-4], texture[2:-6]],
    }
    if kind == "vignetting":
        shade = np.exp(-(((row - 200) / 600) ** 2) - ((column - 500) / 700) ** 2)
        seen = [frame * shade / shade.mean() for frame in frames]
    else:
        seen = [frame + pattern for frame, pattern in zip(frames, patterns[kind], strict=True)]
    ours, estimator = estimator_of(seen)
    pooled, _ = estimator_of(seen, mean="pooled")
    used = (RING > 0) & (RING < 40)

    def excess(estimate: np.ndarray) -> float:
        return float(np.abs(estimate - clean)[used].max() / clean[used].max())

    assert excess(pooled) > 1.0
    assert excess(ours) < 0.35
    assert estimator.background.uneven_illumination == (kind == "vignetting")
    if kind == "moved texture":
        assert estimator.background.shift_pixels == pytest.approx((-2.0, 0.0), abs=0.3) or (
            estimator.background.shift_pixels == pytest.approx((2.0, 0.0), abs=0.3)
        )


def test_copies_of_a_frame_are_refused_and_one_frame_needs_two_patches(rng):
    frame = grains(rng, 1)[0]
    with pytest.raises(InputError, match="copies"):
        estimator_of([frame, frame])
    with pytest.raises(InputError, match="patch"):
        estimator_of([frame], SHAPE)
    with pytest.raises(InputError, match="frame"):
        AutocorrelationEstimator(patch_grid(SHAPE, SIZE)).estimate()


def test_the_frames_unit_scales_the_estimate(rng):
    frames = [torch.from_numpy(frame) for frame in grains(rng, 2)]
    plain, scaled = estimator_of(frames)[0], estimator_of([0.02 * frame + 7.0 for frame in frames])[0]
    used = RING > 0
    np.testing.assert_allclose(scaled[used], 4e-4 * plain[used], rtol=2e-3, atol=4e-8 * plain.max())
