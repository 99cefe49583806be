"""Paths that jump, stop or turn back are followed, and do not look like two objects."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import correlograph as cg
from invert.tracking.breaks import mend
from invert.tracking.light import light_of_frames
from invert.tracking.spectra import Reader
from invert.tracking.start import Start
from tests.invert.field.speckle import expected_frame, fading_frames, letter, travelling_frames

STEP = np.array([2.0, -3.0])
NUMBERS = np.arange(20)

PATHS = {
    "stop": np.minimum(NUMBERS, 9)[:, None] * 3.0 * STEP,
    "turn back": (9 - np.abs(NUMBERS - 9))[:, None] * STEP,
    "jump": NUMBERS[:, None] * STEP + (NUMBERS >= 10)[:, None] * np.array([30.0, -11.0]),
    "two gaps": np.r_[0:8, 10:17, 20:25][:, None] * STEP,
    "shake": np.random.default_rng(1).normal(0.0, 8.0, (20, 2)),
}


def frames_along(path: np.ndarray, rng: np.random.Generator, light: float) -> list[np.ndarray]:
    frames = travelling_frames(letter(64, 28), (300, 340), 128, rng, path, 60.0)
    return [rng.poisson(light * frame).astype(np.float32) for frame in frames]


@pytest.mark.parametrize("kind", PATHS)
def test_a_path_that_does_not_go_on_is_that_of_one_object(kind, rng):
    path = PATHS[kind] - PATHS[kind][0]
    found = cg.track(cg.Capture(frames_along(path, rng, 0.3)))
    assert found.others == ()
    np.testing.assert_array_less(np.abs(found.path_pixels - path)[1:], 5.0 * found.error_pixels[1:])


def test_a_jump_is_found_where_single_frames_are_too_dim(rng):
    """0.006 photoelectrons per pixel: pairs of frames show no displacement, sums of four do."""
    numbers = np.arange(48)
    path = numbers[:, None] * 0.5 * STEP + (numbers >= 21)[:, None] * np.array([40.0, 25.0])
    found = cg.track(cg.Capture(frames_along(path, rng, 0.006)))
    assert found.others == ()
    assert np.abs(found.path_pixels[-1] - path[-1]).max() < 6.0


def test_a_jump_is_found_where_sums_of_four_are_too_dim():
    """0.004 photoelectrons per pixel, eight draws. Sums of eight or sixteen frames show the jump."""
    numbers = np.arange(64)
    path = numbers[:, None] * 0.5 * STEP + (numbers >= 30)[:, None] * np.array([-40.0, 65.0])
    for seed in range(8):
        rng = np.random.default_rng([seed, 3])
        found = cg.track(cg.Capture(frames_along(path, rng, 0.004)))
        assert np.abs(found.path_pixels[-1] - path[-1]).max() < 5.0 * found.error_pixels[-1].max()


def test_faint_light_on_a_changing_illumination_neither_jumps_nor_breaks():
    """0.004 photoelectrons per pixel, four draws: a frame has 270 photons, give or take 16, and the speckle of sums is no white noise."""
    path = np.arange(96)[:, None] * np.array([0.7, -1.1])
    for seed in range(4):
        rng = np.random.default_rng([seed, 7])
        frames = travelling_frames(letter(64, 28), (240, 280), 128, rng, path, 16.0)
        found = cg.track(cg.Capture([rng.poisson(0.004 * frame).astype(np.float32) for frame in frames]))
        np.testing.assert_array_less(np.abs(found.path_pixels - path)[1:], 5.0 * found.error_pixels[1:])


def test_one_faster_step_on_a_changing_illumination_is_no_break():
    """100 photoelectrons per pixel; neighbours share 0.64 of their intensity, and less across a step twice as long."""
    for seed in range(3):
        times = np.arange(24) + (np.arange(24) > 12)
        frames = fading_frames(np.random.default_rng(seed), times, STEP, -np.log(0.64), 100.0)
        assert np.abs(cg.track(cg.Capture(frames)).path_pixels - times[:, None] * STEP).max() < 3.0


def test_the_light_of_frames_is_that_of_their_speckle(rng):
    """Photons in frames are random; half of them in one frame, and twice as many in another, are not."""
    light = np.where(NUMBERS == 4, 0.5, 1.0) * np.where(NUMBERS == 9, 2.0, 1.0)
    for mean, limit in ((0.02, 0.35), (1.0, 0.1)):
        frames = travelling_frames(letter(64, 28), (300, 340), 128, rng, NUMBERS[:, None] * STEP, 1e6)
        frames = [rng.poisson(mean * one * frame).astype(np.float32) for one, frame in zip(light, frames, strict=True)]
        reader = Reader(frames[0].shape, 1)
        band = reader.band(frames)
        found = light_of_frames(reader.all_spectra(frames, band), band)
        assert np.abs(found / np.median(found) - light).max() < limit


@pytest.mark.parametrize("counts", [(8, 0), (5, 3), (8, 4)])
def test_two_short_captures_in_faint_light_are_no_path(counts):
    """0.03 photoelectrons per pixel: two frames show no displacement, two or four on each side do. Four draws of each kind."""
    refused = []
    for seed in range(4):
        rng = np.random.default_rng([seed, *counts])
        parts = [frames_along(np.arange(count)[:, None] * STEP, rng, 0.03) for count in counts if count]
        try:
            cg.track(cg.Capture([frame for part in parts for frame in part]))
        except cg.InputError as error:
            refused.append(str(error))
    assert len(refused) == (4 if counts[1] else 0)
    assert all(f"nothing in common across the boundary after frame {counts[0]}" in one for one in refused)


def test_a_dark_frame_neither_is_nor_hides_a_jump(rng):
    path = NUMBERS[:, None] * STEP
    for jump in (np.zeros(2), np.array([25.0, 0.0])):
        moved = path + (NUMBERS >= 12)[:, None] * jump
        frames = frames_along(moved, rng, 0.3)
        frames[12] = np.zeros_like(frames[12])
        left = np.delete(cg.track(cg.Capture(frames)).path_pixels - moved, 12, 0)
        assert np.abs(left).max() < 1.5


@pytest.mark.parametrize("count", [2, 3])
def test_a_path_goes_on_over_dark_frames(count, rng):
    path = NUMBERS[:20, None] * STEP
    frames = frames_along(path, rng, 0.3)
    frames[9 : 9 + count] = [rng.poisson(0.01, frame.shape).astype(np.float32) for frame in frames[9 : 9 + count]]
    lit = np.delete(cg.track(cg.Capture(frames)).path_pixels - path, range(9, 9 + count), 0)
    assert np.abs(lit).max() < 0.5


def test_a_laser_that_moved_once_is_named(rng):
    path = NUMBERS[:10, None] * STEP
    frames = [*frames_along(path, rng, 0.3), *frames_along(path, np.random.default_rng(5), 0.3)]
    with pytest.raises(cg.InputError, match="after frame 10"):
        cg.track(cg.Capture(frames))


@pytest.mark.parametrize("lost", ["frames", "light"])
def test_a_gap_across_which_nothing_is_the_same_is_an_error(lost, rng):
    """Two patterns before and after a gap, or two dark frames between: the path across it cannot be known."""
    path = NUMBERS[:10, None] * STEP
    frames = [*frames_along(path[:5], rng, 0.3), *frames_along(path[5:], np.random.default_rng(5), 0.3)]
    if lost == "light":
        frames[4], frames[5] = np.zeros_like(frames[4]), np.zeros_like(frames[5])
    with pytest.raises(cg.InputError, match="nothing in common across the boundary"):
        cg.track(cg.Capture(frames))


SMOOTH = np.arange(192)[:, None]


@pytest.mark.parametrize(
    "path",
    [
        SMOOTH * np.array([0.3, -0.4]) + 8.0 * np.tanh((SMOOTH - 100) / 3.0) * np.array([1.0, 0.3]),
        SMOOTH * np.array([0.3, -0.4]) + 5.0 * np.sin(2.0 * np.pi * SMOOTH / 16.0) * np.array([1.0, 0.3]),
    ],
    ids=["swerve", "vibration"],
)
def test_a_smooth_path_does_not_jump(path, rng):
    """The approximate path of blocks of frames strays from these by grains."""
    frames = travelling_frames(letter(64, 28), (200, 220), 128, rng, path, 60.0)
    found = cg.track(cg.Capture([rng.poisson(0.3 * frame).astype(np.float32) for frame in frames]))
    assert np.abs(found.path_pixels - (path - path[0])).max() < 1.0


def test_a_fast_object_turns_back_in_dimmer_light(rng):
    """Eighty rows a frame, then back: the jump from the path that goes on is more than half a frame. The light falls to half before."""
    path = (14 - np.abs(NUMBERS - 14))[:, None] * np.array([80.0, 3.0])
    frames = travelling_frames(letter(64, 28), (300, 340), 128, rng, path, 60.0)
    light = np.where(NUMBERS < 10, 0.4, 0.2)
    found = cg.track(
        cg.Capture([rng.poisson(one * frame).astype(np.float32) for one, frame in zip(light, frames, strict=True)])
    )
    np.testing.assert_array_less(np.abs(found.path_pixels - path)[1:], 5.0 * found.error_pixels[1:])


def test_a_steady_path_stays_as_it_is(rng):
    frames = frames_along(NUMBERS[:, None] * STEP, rng, 0.3)
    reader = Reader(frames[0].shape, 1)
    band = reader.band(frames)
    start = Start(NUMBERS[:, None] * STEP, 100.0, 1.0)
    found = mend(reader.all_spectra(frames, band), band, start)
    assert found.path is start.path
    assert found.is_continuous
    assert found.jumps == 0


def test_static_light_under_a_laser_that_moves_is_no_path(rng):
    texture = np.clip(1.0 + 0.3 * gaussian_filter(rng.standard_normal((300, 340)), 3.0) / 0.094, 0.0, None)
    frames = [
        rng.poisson(0.3 * (expected_frame(letter(64, 28), (300, 340), 128, rng) + texture)).astype(np.float32)
        for _ in range(12)
    ]
    with pytest.raises(cg.InputError, match="as a whole"):
        cg.track(cg.Capture(frames))


def test_one_bright_frame_hides_no_path(rng):
    path = NUMBERS[:16, None] * STEP
    frames = travelling_frames(letter(64, 28), (300, 340), 128, rng, path, 60.0)
    frames[7] = 40.0 * frames[7]
    found = cg.track(cg.Capture([rng.poisson(0.5 * frame).astype(np.float32) for frame in frames]))
    assert np.abs(found.path_pixels - path).max() < 0.6
