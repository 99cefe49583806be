"""Counts of cameras with any gain, offset and read noise; background from contrast; the spectrum of speckle."""

import numpy as np
import pytest
import torch
from PIL import Image

import correlograph as cg
from correlograph.errors import InputError
from invert.field.counts import Calibration, background_of, read_counts
from invert.field.filtering import filter_counts, intensity_spectrum, variance_transfer
from invert.field.forward_model import ForwardModel
from invert.field.grid import field_grid
from invert.field.prior import prior_from_albedo
from radiometry.estimation.noise_curve import noise_curve
from radiometry.field_forecast import bounding_box
from tests.invert.field.speckle import expected_frame, letter

PATCH, SHAPE = 150, (700, 812)


@pytest.fixture(scope="module")
def scene():
    """Grid, forward model and prior of the letter, and the intensity of two frames without pixel blur."""
    albedo = letter()
    grid = field_grid(SHAPE, (PATCH, PATCH), bounding_box(albedo))
    model = ForwardModel(grid, torch.ones(grid.shape[0], grid.shape[1] // 2 + 1))
    rng = np.random.default_rng(8)
    return grid, model, prior_from_albedo(albedo, grid), [expected_frame(albedo, SHAPE, PATCH, rng) for _ in range(2)]


@pytest.mark.parametrize(("gain", "offset", "read"), [(1.0, 0.0, 0.0), (2.5, 40.0, 0.0), (0.4, 0.0, 1.5)])
def test_counts_have_the_variance_of_their_mean(scene, gain, offset, read):
    grid, _, _, intensity = scene
    rng = np.random.default_rng(4)
    electrons = [rng.poisson(3.0 * one) + read * rng.standard_normal(SHAPE) for one in intensity]
    frames = [(gain * one + offset).astype(np.float32) for one in electrons]
    found = Calibration.of(frames, gain**2 * (3.0 + read**2))
    assert found.gain == pytest.approx(gain, rel=0.05)
    assert found.shift == pytest.approx(read**2 - offset / gain, abs=0.25)
    counts = read_counts(frames[0], found, grid, torch.Generator().manual_seed(1))
    expected = 3.0 * grid.bin(intensity[0])
    noise = counts.values - expected - counts.background
    assert float(noise[counts.fitted].var()) == pytest.approx(float(counts.values[counts.fitted].mean()), rel=0.1)
    assert float(counts.held_out.float().mean()) == pytest.approx(0.05, abs=0.005)
    assert not (counts.held_out & counts.fitted).any()


@pytest.mark.parametrize(("gain", "roughness"), [(1.0, 0.4), (2.0, 0.2)])
def test_roughness_of_the_wall_is_measured(scene, gain, roughness):
    _, _, _, intensity = scene
    rng = np.random.default_rng(9)
    lights = [2.0 * one * rng.gamma(1.0 / roughness, roughness, SHAPE) for one in intensity]
    frames = [(gain * rng.poisson(light)).astype(np.float32) for light in lights]
    found = Calibration.of(frames, gain**2 * (2.0 + 8.0 * roughness), gain)
    assert found.roughness == pytest.approx(roughness, rel=0.3)
    assert found.gain == pytest.approx(gain)
    smooth = [(gain * rng.poisson(2.0 * one)).astype(np.float32) for one in intensity]
    assert Calibration.of(smooth, gain**2 * 2.0).roughness == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_the_noise_curve_is_unbiased_within_its_errors(seed):
    rng = np.random.default_rng(seed)
    gain, offset, read = rng.uniform(0.3, 3.0), rng.uniform(-20.0, 20.0), rng.uniform(0.0, 2.0)
    light = rng.uniform(1.0, 6.0) * expected_frame(letter(), SHAPE, PATCH, rng)
    frame = gain * (rng.poisson(light) + read * rng.standard_normal(SHAPE)) + offset
    image = torch.from_numpy(frame.astype(np.float32))
    curve = noise_curve([image], [torch.ones(SHAPE, dtype=torch.bool)]).given(2, 0.0)
    expected = np.array((gain**2 * read**2 - gain * offset, gain))
    assert (np.abs(curve.coefficients[:2] - expected) < 4.0 * curve.errors[:2] + 0.01 * np.abs(expected)).all()


@pytest.mark.parametrize("ambient", [0.0, 0.5, 2.0])
def test_background_from_the_contrast(scene, ambient):
    grid, model, prior, intensity = scene
    rng = np.random.default_rng(5)
    frames = [rng.poisson(2.0 * one + ambient).astype(np.float32) for one in intensity]
    counts = [read_counts(one, Calibration(1.0, 0.0), grid, torch.Generator().manual_seed(1)) for one in frames]
    kept = variance_transfer(intensity_spectrum(prior, model), model)
    grains = float(prior.sum() ** 2 / prior.square().sum())
    found = background_of(counts, kept, grains)
    pixels = grid.binning[0] * grid.binning[1]
    assert found == (0.0 if ambient == 0.0 else pytest.approx(ambient * pixels, rel=0.25))


@pytest.mark.parametrize(("light", "read"), [(0.3, 0.2), (0.3, 1.0), (3.0, 0.5)])
def test_clipped_read_noise_is_not_taken_for_light(scene, light, read):
    """With few counts and read noise, clipping below zero raises the mean and lowers the variance."""
    grid, model, prior, intensity = scene
    rng, pixels = np.random.default_rng(12), grid.binning[0] * grid.binning[1]
    frames = [
        (rng.poisson(light / pixels * one) + read / pixels**0.5 * rng.standard_normal(SHAPE)).astype(np.float32)
        for one in intensity
    ]
    counts = [read_counts(one, Calibration(1.0, read**2 / pixels), grid, torch.Generator().manual_seed(1)) for one in frames]
    mean = float(np.mean(intensity)) * light
    assert np.mean([one.signal for one in counts]) == pytest.approx(mean, rel=0.05)
    kept = variance_transfer(intensity_spectrum(prior, model), model)
    grains = float(prior.sum() ** 2 / prior.square().sum())
    assert background_of(counts, kept, grains) == pytest.approx(counts[0].background, abs=0.1 * mean)


def test_hot_pixels_are_unmeasured(scene):
    grid, _, _, intensity = scene
    frame = np.random.default_rng(6).poisson(5.0 * intensity[0]).astype(np.float32)
    row, column = 301, 402
    frame[row, column] = 1e5
    counts = read_counts(frame, Calibration(1.0, 0.0), grid, torch.Generator().manual_seed(1))
    cell = row // grid.binning[0], column // grid.binning[1]
    assert not counts.fitted[cell]
    assert not counts.held_out[cell]
    assert float(counts.values[cell]) < 1e3


def test_masked_pixels_are_unmeasured(scene, tmp_path):
    grid, _, _, intensity = scene
    mask = np.ones(SHAPE, np.uint8)
    mask[100:200, 300:500] = 0
    Image.fromarray(mask * 255).save(tmp_path / "mask.png")
    frame = np.random.default_rng(6).poisson(5.0 * intensity[0]).astype(np.float32)
    capture = cg.Corrections(mask=tmp_path / "mask.png").apply(cg.Capture([frame]))
    assert np.array_equal(capture.measured, mask.astype(bool))
    counts = read_counts(capture.frames[0], Calibration(1.0), grid, torch.Generator().manual_seed(1), None, capture.measured)
    inside = tuple(
        slice(first // bins + 1, last // bins - 1)
        for first, last, bins in zip((100, 300), (200, 500), grid.binning, strict=False)
    )
    assert not counts.fitted[inside].any()
    assert not counts.held_out[inside].any()
    assert float((counts.fitted | counts.held_out).float().mean()) == pytest.approx(mask.mean(), abs=0.01)


@pytest.mark.parametrize("kept", [0.9, 0.5, 0.3])
def test_masks_do_not_change_the_calibration(scene, kept):
    """Masked pixels hold the mean of the frame, without noise."""
    _, _, _, intensity = scene
    rng = np.random.default_rng(3)
    used = np.zeros(SHAPE, bool)
    used[: round(kept * SHAPE[0])] = True
    frames = [rng.poisson(5.0 * one).astype(np.float32) for one in intensity]
    masked = [np.where(used, one, one[used].mean()).astype(np.float32) for one in frames]
    found = Calibration.of(masked, 5.0 * kept, None, used)
    assert found.gain == pytest.approx(1.0, abs=0.06)
    assert found.shift == pytest.approx(0.0, abs=0.3)


def test_a_mask_without_whole_binned_pixels_is_refused(scene):
    grid, _, _, intensity = scene
    used = np.zeros(SHAPE, bool)
    used[::2, ::2] = True
    frame = np.random.default_rng(6).poisson(5.0 * intensity[0]).astype(np.float32)
    with pytest.raises(InputError, match="measured pixels or more"):
        read_counts(frame, Calibration(1.0), grid, torch.Generator().manual_seed(1), None, used)


def test_dark_frames_are_refused():
    with pytest.raises(InputError, match="light in the first frames"):
        Calibration.of([np.zeros(SHAPE, np.float32)], 1.0)


def test_the_spectrum_is_that_of_speckle(scene):
    grid, model, prior, intensity = scene
    spectrum = intensity_spectrum(prior, model)
    kept = variance_transfer(spectrum, model)
    assert kept == pytest.approx(1.0, abs=0.02)  # the variance of speckle is the squared mean, and H is 1
    binned = torch.stack([grid.bin(one) for one in intensity]) / (grid.binning[0] * grid.binning[1])
    power = torch.fft.rfft2(binned - binned.mean((-2, -1), keepdim=True)).abs().square().mean(0) / binned[0].numel()
    low = float(power[1:20, 1:20].mean()) / float(spectrum[1:20, 1:20].mean())
    assert low == pytest.approx(1.0, abs=0.25)


def test_the_filter_reads_no_held_out_pixel(scene):
    grid, model, prior, intensity = scene
    frame = np.random.default_rng(7).poisson(2.0 * intensity[0]).astype(np.float32)
    counts = read_counts(frame, Calibration(1.0, 0.0), grid, torch.Generator().manual_seed(1))
    spectrum = intensity_spectrum(prior, model)
    before = filter_counts(counts, spectrum, model)
    counts.values[counts.held_out] = 1e6
    assert torch.equal(before, filter_counts(counts, spectrum, model))
    seen, true = grid.on_frame(before)[counts.held_out], grid.bin(2.0 * intensity[0])[counts.held_out]
    assert float(torch.corrcoef(torch.stack((seen, true)))[0, 1]) > 0.8
