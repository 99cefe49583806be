"""Faults of a sensor, and frames that show something else, move no path."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal.windows import tukey

pytest.importorskip("mitsuba")

import correlograph as cg
from invert.tracking.band import TAPER
from invert.tracking.spectra import lines_are_uneven
from invert.tracking.tracker import track
from tests.invert.test_tracking import drifting

FRAMES = 24
NUMBERS = np.arange(FRAMES)
PATH = np.stack([1.7 * NUMBERS + 3.0 * np.sin(NUMBERS / 4.0), -0.9 * NUMBERS], 1)


def check(frames, interpolated=()):
    """The only path is that of the object, within its stated errors."""
    found = track(cg.Capture(tuple(frames)))
    assert found.others == ()
    deviations = found.path_pixels[1:] - PATH[1:]
    assert np.abs(deviations / found.error_pixels[1:]).max() < 4.0
    assert found.interpolated == interpolated
    return found


@pytest.mark.parametrize("light", [0.05, 1.0])
@pytest.mark.parametrize("fault", ["hot row", "hot column", "fixed rows", "changing columns", "both"])
def test_uneven_lines_move_no_path_and_are_no_object(rng, light, fault):
    """A line that flickers was an object that moved along itself, at 207 standard deviations; so were fixed offsets of the rows."""
    frames = np.array(drifting(rng, PATH, light))
    rows, columns = frames.shape[1:]
    if fault == "hot row":
        frames[:, 77] += 500.0 * rng.random((FRAMES, 1))
    if fault == "hot column":
        frames[:, :, 101] += 50.0 * rng.random((FRAMES, 1))
    if fault in ("fixed rows", "both"):
        frames += 0.3 * rng.standard_normal((1, rows, 1))
    if fault in ("changing columns", "both"):
        frames += 0.3 * rng.standard_normal((FRAMES, 1, columns))
    check(frames)


@pytest.mark.parametrize("light", [0.05, 1.0, 20.0])
@pytest.mark.parametrize("fault", ["one hot pixel", "hot pixels", "weak hot pixels", "cosmic rays"])
def test_hot_pixels_and_cosmic_rays_move_no_path_and_are_no_object(rng, light, fault):
    """One hot pixel was an object at rest, twelve hid the object that moves, and one cosmic ray hid all."""
    frames = np.array(drifting(rng, PATH, light), np.float32)
    count, pixels = len(frames), frames[0].size
    hot = {"one hot pixel": (1, 3000.0), "hot pixels": (pixels // 10_000, 1000.0), "weak hot pixels": (pixels // 1000, 50.0)}
    if fault in hot:
        number, level = hot[fault]
        places = rng.choice(pixels, number, replace=False)
        frames.reshape(count, -1)[:, places] += rng.poisson(light * level * rng.uniform(0.5, 1.5, number), (count, number))
    else:
        for frame in frames:
            frame.flat[rng.choice(pixels, rng.poisson(pixels / 10_000), replace=False)] += rng.uniform(50.0, 2000.0)
    check(frames)


def test_reversed_views_and_other_byte_orders_are_the_frames_that_they_show(rng):
    """Either ended reconstructions and rotations with a traceback."""
    frames = np.array(drifting(rng, PATH, 1.0), np.float32)
    for changed in (frames[:, ::-1], frames.astype(">u2")):
        held = cg.Capture(changed).frames
        assert all(one.dtype.isnative and min(one.strides) > 0 for one in held)
        np.testing.assert_array_equal(held, changed)
    same = tuple(frames)
    assert cg.Capture(same).frames is same


@pytest.mark.parametrize("factor", [1e-15, 1e12])
def test_values_beyond_single_precision_are_refused(rng, factor):
    frames = np.array(drifting(rng, PATH[:6], 1.0), np.float32)
    with pytest.raises(cg.InputError, match="scale the frames"):
        track(cg.Capture(tuple(frames * np.float32(factor))))


def test_a_pattern_at_rest_is_named(rng):
    """A warning says that a pattern at rest may be one of the sensor; the object that moves has none."""
    frames = np.array(drifting(rng, PATH, 1.0), np.float32)
    pattern = rng.standard_normal(frames[0].shape)
    found = track(cg.Capture(tuple(frames + 2.0 * pattern.astype(np.float32))))
    named = [one for one in (found, *found.others) if any("stays at rest" in warning for warning in one.warnings)]
    assert len(named) == 1
    assert named[0].is_at_rest


def test_speckle_of_any_shape_has_no_uneven_lines(rng):
    """Spectra of random objects, wide and narrow, are taken for uneven lines at most once in 400."""
    count = 0
    for _ in range(200):
        size = rng.integers(6, 80, 2)
        albedo = np.zeros((256, 320))
        albedo[: size[0], : size[1]] = rng.random(size) < rng.uniform(0.1, 1.0)
        field = np.fft.fft2(albedo * np.exp(2j * np.pi * rng.random(albedo.shape)))[: 200 + size[0], : 240 + size[1]]
        light = rng.poisson(10.0 ** rng.uniform(-1.0, 1.0) * np.abs(field) ** 2 / np.mean(np.abs(field) ** 2))
        power = np.abs(np.fft.rfft2((light - light.mean()) * np.outer(*(tukey(side, TAPER) for side in light.shape)))) ** 2
        count += sum(lines_are_uneven(power, axis) for axis in (0, 1))
    assert count <= 1


@pytest.mark.parametrize("light", [0.05, 1.0])
@pytest.mark.parametrize("strange", ["blank", "saturated", "faint lamp", "lamp", "other speckle"])
def test_a_frame_that_shows_something_else_is_interpolated_and_named(rng, light, strange):
    """It was off by up to 120 pixels at a stated error of 0.3."""
    frames = np.array(drifting(rng, PATH, light))
    levels = {"blank": 0.0, "faint lamp": light / 5.0, "lamp": 10.0 * light}
    if strange in levels:
        frames[10] = rng.poisson(levels[strange], frames[0].shape)
    else:
        frames[10] = 65535.0 if strange == "saturated" else drifting(rng, np.zeros((1, 2)), light)[0]
    found = check(frames, interpolated=(10,))
    assert found.warnings == ("frames that share nothing with those beside them, whose positions are interpolated: 10",)
    assert np.abs(found.path_pixels[10] - PATH[10]).max() < 0.5


def test_strange_frames_at_the_ends_and_beside_each_other(rng):
    circle = 20.0 * np.stack([np.sin(np.arange(48) / 5.0), np.cos(np.arange(48) / 5.0)], 1)
    frames = np.array(drifting(rng, circle, 0.5))
    strange = (0, 20, 21, 47)
    for number in strange:
        frames[number] = rng.poisson(0.5, frames[0].shape)
    found = track(cg.Capture(tuple(frames)))
    assert found.interpolated == strange
    deviations = found.path_pixels - circle
    deviations -= deviations[10]  # the first frame is strange
    assert np.abs(deviations[1:47]).max() < 0.3
    assert np.abs(deviations[47] / found.error_pixels[47]).max() < 3.0


@pytest.mark.parametrize("light", [0.1, 3.0])
def test_interpolated_positions_are_within_their_errors(light):
    """A random walk, a vibration and missing files: the frame before the gap is strange, another, and the last one."""
    strange, kept = (5, 12, 23), np.delete(np.arange(FRAMES + 2), (6, 7))
    missed = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        walk = np.cumsum(rng.standard_normal((FRAMES + 2, 2)), 0) + np.outer(np.sin(2.5 * np.arange(FRAMES + 2)), [1.0, 0.0])
        path = walk[kept] - walk[0]
        frames = drifting(rng, path, light)
        for number in strange:
            frames[number] = rng.poisson(light, frames[0].shape).astype(np.float32)
        found = track(cg.Capture(tuple(frames), names=tuple(f"f{number:02}.tif" for number in kept)))
        assert found.interpolated == strange
        assert found.warnings[1].endswith(": 5, 14, 25")
        missed.append((found.path_pixels - path)[list(strange)] / found.error_pixels[list(strange)])
    assert 0.05 < np.mean(np.square(missed)) < 2.5
    assert np.abs(missed).max() < 4.0


def test_good_frames_are_not_strange():
    """Random walks in clear, faint and uneven light."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        light = 10.0 ** rng.uniform(-1.5, 1.0) * rng.choice([0.1, 1.0], 12)
        assert (
            track(cg.Capture(tuple(drifting(rng, np.cumsum(2.0 * rng.standard_normal((12, 2)), 0), light)))).interpolated == ()
        )
