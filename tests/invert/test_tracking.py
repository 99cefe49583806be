"""Speckle of a moving object travels over the wall by u (1 + z / d1); the tracker finds it with honest errors."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

pytest.importorskip("mitsuba")

import correlograph as cg
from invert.track import main
from invert.tracking.numbers import doubts_of_order, frame_numbers
from invert.tracking.smoothing import PathNoise
from invert.tracking.track import Track
from invert.tracking.tracker import track
from sim.rendering import render_geometry
from tests.invert.field.speckle import letter, travelling_frames

FRAMES = 10

SOURCE_ANGLE_DEG = (0.0, 12.0)


@pytest.fixture(scope="module")
def lab():
    """The reference scene on a smaller frame, with the laser at rest."""
    geometry = cg.load("corner_letter").geometry
    geometry = geometry.with_camera(frame_shape=(560, 640))
    return replace(geometry, spot=replace(geometry.spot, scan_step_m=0.0))


def moving(lab, rng, photoelectrons):
    """Return a capture of an object with a random velocity at a light level, its exposure, and the expected step in pixels."""
    per_s = 0.0882 / 0.125
    exposure_s = photoelectrons / per_s
    step_m = rng.uniform(1e-6, 8e-6) * np.array((np.cos(angle := rng.uniform(0.0, 2.0 * np.pi)), np.sin(angle), 0.0))
    geometry = lab.with_exposure(exposure_s).with_velocity(step_m / exposure_s)
    expected = geometry.travel @ geometry.object_way_m
    return render_geometry(geometry, FRAMES, int(rng.integers(1000))), exposure_s, expected


@pytest.mark.parametrize("seed", range(4))
def test_steps_and_path_are_those_of_the_object(lab, seed):
    """One object, no other; the light of the reference scene comes from 12 degrees."""
    rng = np.random.default_rng(seed)
    capture, exposure_s, expected = moving(lab, rng, 10.0 ** rng.uniform(-1.5, 0.0))
    angle = SOURCE_ANGLE_DEG
    found = track(capture, source_distance_m=lab.source_distance_m, source_angle_deg=angle, interval_s=exposure_s)
    assert found.significance > 20.0
    assert found.others == ()
    truth_m_s = np.linalg.solve(lab.travel, expected) / exposure_s
    np.testing.assert_array_less(np.abs(found.velocity_m_s - truth_m_s), 4.0 * found.velocity_error_m_s)
    deviation = found.path_m - np.arange(FRAMES)[:, None] * truth_m_s * exposure_s
    np.testing.assert_array_less(np.abs(deviation[1:]), 5.0 * found.error_m[1:])
    assert found.velocity_error_m_s.max() < 0.03 * np.abs(truth_m_s).max()
    np.testing.assert_allclose(found.metres_per_pixel, np.linalg.inv(lab.travel), rtol=2e-3, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("light", [0.01, 1.0])
def test_standard_errors_are_honest(lab, light):
    """A hundredth of a photoelectron per pixel, and one: deviations of the velocities in units of their standard errors have a mean square
    of 1. In bright frames, the illumination's speckle on the object is what limits them."""
    deviations = []
    for seed in range(6):
        capture, exposure_s, expected = moving(lab, np.random.default_rng(100 + seed), light)
        truth_m_s = np.linalg.solve(lab.travel, expected) / exposure_s
        found = track(
            capture, source_distance_m=lab.source_distance_m, source_angle_deg=SOURCE_ANGLE_DEG, interval_s=exposure_s
        )
        deviations.append((found.velocity_m_s - truth_m_s) / found.velocity_error_m_s)
    assert 0.26 < np.mean(np.square(deviations)) < 2.4  # chi^2 of 12 degrees of freedom, 99.5 % each side


def test_an_object_at_rest_does_not_move(lab):
    geometry = lab.with_exposure(0.02).with_velocity(np.array([1e-12, 0.0, 0.0]))
    found = track(render_geometry(geometry, 5, 2))
    np.testing.assert_array_less(np.abs(found.path_pixels[1:]), 5.0 * found.error_pixels[1:])


def test_independent_frames_are_refused(lab):
    """The spot moved between frames: no shift is common to them."""
    geometry = replace(lab, spot=replace(lab.spot, scan_step_m=None))
    for seed in range(2):
        with pytest.raises(cg.InputError, match="moves as a whole"):
            track(render_geometry(geometry.with_exposure(0.01), 4, seed))


def test_the_command_writes_path_and_velocity(lab, tmp_path):
    capture, exposure_s, expected = moving(lab, np.random.default_rng(9), 0.3)
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, frame in enumerate(capture.frames):
        np.save(folder / f"{number:03d}.npy", frame)
    main(
        [
            *(str(folder), "-o", str(tmp_path / "out"), "--source-distance-m", str(lab.source_distance_m)),
            *("--frames-per-s", str(1.0 / exposure_s), "--wavelength-m", "532e-9", "--distance-m", str(lab.distance_m)),
            *("--pixel-pitch-m", str(lab.camera.pixel_pitch_m)),
        ]
    )
    content = json.loads((tmp_path / "out" / "track.json").read_text())
    np.testing.assert_allclose(content["step_pixels"], expected, atol=0.1)
    with open(tmp_path / "out" / "track.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == FRAMES
    assert float(rows[-1]["row_pixels"]) == pytest.approx((FRAMES - 1) * expected[0], abs=1.0)
    assert {"row_m", "column_m", "row_error_m", "row_error_pixels"} <= rows[0].keys()
    assert 0.0 < content["velocity_error_m_s"][0] < 0.05 * np.hypot(*content["velocity_m_s"])
    assert (tmp_path / "out" / "track.png").stat().st_size > 1000


def test_impossible_arguments_are_refused(lab):
    capture, _, _ = moving(lab, np.random.default_rng(3), 0.3)
    angles = {"source_distance_m": 1.0, "source_angle_deg": (0.0, 85.0)}
    alone = {"source_angle_deg": (0.0, 12.0)}
    as_text = [
        {"interval_s": "0.004"},
        {"source_distance_m": "0.5"},
        {"source_distance_m": 0.5, "source_angle_deg": ("1", "2")},
    ]
    for arguments in (
        *as_text,
        {"source_distance_m": -1.0},
        {"interval_s": 0.0},
        {"source_distance_m": float("nan")},
        angles,
        alone,
    ):
        with pytest.raises(cg.InputError):
            track(capture, **arguments)
    for binning in (0, 1.5, 100):
        with pytest.raises(cg.InputError, match="binning: expected a whole number"):
            track(capture, binning=binning)
    with pytest.raises(cg.InputError, match="the exposure of the frames"):
        track(capture, interval_s=1e-12)
    frames = list(capture.frames)
    for spoilt, message in (
        ([*frames[:4], frames[3], *frames[4:]], "frame 4 is a copy of frame 3"),
        ([*frames, frames[2]], "is a copy of frame 2"),
        ([*frames, np.nan * frames[0]], "NaN"),
    ):
        with pytest.raises(cg.InputError, match=message):
            track(cg.Capture(spoilt))
    with pytest.raises(cg.InputError, match="3 or more"):
        track(cg.Capture(capture.frames[:2]))
    with pytest.raises(cg.InputError, match="capture"):
        track(np.zeros((4, 200, 200)))


def drifting(rng, path, light, shape=(300, 340)):
    """Frames of one speckle pattern with grains of 6 pixels at positions (frames, 2), in pixels and fractions of them; light is the mean of
    all frames, or of each."""
    side = [n + 40 + 2 * int(np.abs(path).max()) for n in shape]
    radius = np.hypot(np.fft.fftfreq(side[0])[:, None], np.fft.fftfreq(side[1])[None])
    spectrum = (rng.standard_normal(side) + 1j * rng.standard_normal(side)) * (radius < 0.08)
    frames = []
    for row, column in path:
        phase = np.exp(-2j * np.pi * (np.fft.fftfreq(side[0])[:, None] * row + np.fft.fftfreq(side[1])[None] * column))
        intensity = np.abs(np.fft.ifft2(spectrum * phase)) ** 2
        top, left = (int(np.abs(path).max()) + 10,) * 2
        frames.append(intensity[top : top + shape[0], left : left + shape[1]])
    frames = np.array(frames)
    lights = np.broadcast_to(light, len(path))
    return [rng.poisson(mean * frame / frames.mean()).astype(np.float32) for mean, frame in zip(lights, frames, strict=True)]


@pytest.mark.parametrize(
    "light", [np.where(np.arange(30) == 12, 1.5, 0.5), np.where(np.arange(30) < 5, 9.0, 3.0), np.geomspace(20.0, 2.0, 12)]
)
def test_frames_of_other_brightness_have_their_own_places(light, rng):
    """A frame of k times the light pulls k times as hard, and is k times as stiff. Once, all counted as equally stiff, and bright frames
    were off by 40 to 150 stated errors."""
    path = np.arange(len(light))[:, None] * np.array([1.3, -2.2])
    found = track(cg.Capture(drifting(rng, path, light)))
    assert np.abs(found.path_pixels[1:] - path[1:]).max() < 0.5
    ratio = (found.path_pixels[1:] - path[1:]) / found.error_pixels[1:]
    assert np.abs(ratio).max() < 4.5
    assert 0.2 < np.sqrt((ratio**2).mean()) < 2.0
    assert not found.warnings  # frames far apart share as much of their light


@pytest.mark.parametrize(
    "light",
    [
        30.0 ** np.linspace(0.0, 1.0, 24),
        1000.0 ** np.linspace(1.0, 0.0, 24),
        np.where(np.arange(24) < 12, 15.0, 1.0),
        np.where(np.arange(24) < 12, 1.0, 100.0),
        np.where(np.arange(24) < 12, 1000.0, 1.0),
    ],
)
def test_curved_paths_are_found_in_light_that_changes_much(light, rng):
    """Once, all frames had to show as much above the noise of the brightest, so that blocks too long for the bends were taken; light that a
    window leaks counted as noise; and the windows drew bright frames more than once. Paths were off by 5 to 90 pixels, 70 stated errors."""
    t = np.arange(24)
    path = np.stack([1.7 * t + 6.0 * np.sin(t / 5.0), -2.3 * t + 4.0 * np.cos(t / 4.0) - 4.0], 1)
    found = track(cg.Capture(drifting(rng, path, 0.5 * light)))
    assert not found.others
    assert not found.warnings
    away = found.path_pixels - path + path[0]
    assert np.abs(away).max() < 0.15
    assert np.sqrt(((away[1:] / found.error_pixels[1:]) ** 2).mean()) < 1.5


def test_two_objects_in_light_that_falls_have_the_places_of_those_in_steady_light():
    """The light falls to a tenth. Once, paths were off by 0.9 and 1.4 pixels, 50 stated errors; in steady light, they are off by 0.2."""
    rng, light = np.random.default_rng(2), np.geomspace(3.0, 0.3, 40)
    paths = [np.arange(40)[:, None] * np.array(step) for step in ((1.3, -2.2), (-1.1, 1.4))]
    frames = [drifting(rng, path, part * light, (420, 460)) for path, part in zip(paths, (3.0, 2.0), strict=True)]
    found = track(cg.Capture([np.add(*both) for both in zip(*frames, strict=True)]))
    tracks = [found, *found.others]
    assert len(tracks) == 2
    for path in paths:
        assert min(np.abs(one.path_pixels - path).max() for one in tracks) < 0.5


def test_a_path_that_could_be_a_side_shorter_is_refused(rng):
    """140 of 300 rows per frame, and 160 the other way, have the same spectra."""
    path = np.outer(np.arange(3), [140.0, 3.0])
    with pytest.raises(cg.InputError, match="or a side more or less"):
        track(cg.Capture(drifting(rng, path, 5.0)))


def test_a_flat_field_removes_what_the_wall_draws(rng, tmp_path):
    """A wall with a texture of 15 % is light at rest: its path is drawn towards zero, unless frames are divided by a flat-field frame."""
    path = np.outer(np.arange(16), [0.3, -0.5])
    texture = 1.0 + 0.15 * gaussian_filter(rng.standard_normal((300, 340)), 3.0) * 10.6
    folder, flat = tmp_path / "frames", tmp_path / "flat.npy"
    folder.mkdir()
    np.save(flat, rng.poisson(2e4 * texture).astype(np.float32))
    for number, frame in enumerate(drifting(rng, path, 50.0)):
        np.save(folder / f"{number:03d}.npy", rng.poisson(frame * texture).astype(np.float32))
    steps = []
    for name, options in (("plain", []), ("flat", ["--flat", str(flat)])):
        main([str(folder), "-o", str(tmp_path / name), *options])
        steps.append(json.loads((tmp_path / name / "track.json").read_text())["step_pixels"])
    off = [np.linalg.norm(np.array(step) - path[1]) / np.linalg.norm(path[1]) for step in steps]
    assert off[0] > 0.01
    assert off[1] < 0.006


def test_a_window_does_not_draw_paths_of_large_grains_towards_zero():
    """A rigid pattern with grains of 32 x 48 pixels in frames of 420 x 520: the windows stay where they are, which draws its path by 5 %.
    Of this, 2 % are left."""
    step, reached = np.array([3.6, -5.2]), []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        frames = travelling_frames(letter(40, 16), (420, 520), 512, rng, np.arange(10)[:, None] * step, 1e9)
        found = track(cg.Capture([rng.poisson(0.2 * frame).astype(np.float32) for frame in frames]))
        reached.append(found.path_pixels[-1] / (9.0 * step))
    assert np.mean(reached) == pytest.approx(1.0, abs=0.03)


def test_rigid_speckle_is_followed_to_the_cramer_rao_bound(rng):
    """A curved path, 0.05 photoelectrons per pixel: rms error within 1.7 times the bound of a frame whose pattern is known, which window,
    measured pattern and limited band raise, and standard errors that say so."""
    numbers = np.arange(48)
    path = np.stack([3.0 * np.sin(numbers / 5.0), 0.7 * numbers - 2.0 * np.cos(numbers / 7.0)], 1)
    path -= path[0]
    light = 0.05
    found = track(cg.Capture(drifting(rng, path, light)))
    left = found.path_pixels - path
    left -= left.mean(0)
    # Uniform disc of frequencies: the spectrum of the intensity is the autocorrelation of the disc, 0.5 per pixel of variance.
    pattern = np.array(drifting(rng, np.zeros((1, 2)), 1e6)[0]) / 1e6
    slopes = [np.gradient(pattern, axis=axis) for axis in (0, 1)]
    information = light * np.array([(slope**2 / np.maximum(pattern, 1e-3)).sum() for slope in slopes])
    assert float(np.sqrt(np.mean(left.var(0) * information))) < 1.7
    assert 0.15 < np.mean((left / found.error_pixels[24]) ** 2) < 0.8  # about a mean, not from the first frame: half


@pytest.mark.parametrize("frames", [32, 65])
def test_two_patterns_are_two_objects(frames, rng):
    """Intensities of two objects that move differently add; both paths are found, the brighter first, and nothing else."""
    numbers = np.arange(frames)[:, None]
    paths = [numbers * np.array([0.8, -0.3]), numbers * np.array([-0.6, 1.1])]
    frames = [a + b for a, b in zip(drifting(rng, paths[0], 0.3), drifting(rng, paths[1], 0.15), strict=True)]
    found = track(cg.Capture(frames))
    assert len(found.others) == 1
    np.testing.assert_allclose(found.step_pixels, [0.8, -0.3], atol=0.02)
    np.testing.assert_allclose(found.others[0].step_pixels, [-0.6, 1.1], atol=0.05)
    assert found.share / found.others[0].share == pytest.approx(4.0, rel=0.3)  # squares of the light


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_two_changing_patterns_are_told_apart(seed):
    """The fainter object has a third to a half of the light, speckle lasts for twenty frames, and the two move apart by about a grain in
    two frames: both are found, neither follows the other, and there is no third."""
    rng = np.random.default_rng(seed)
    numbers, angle = np.arange(40)[:, None], rng.uniform(0.0, 2.0 * np.pi)
    step = rng.uniform(-1.0, 1.0, 2)
    apart = rng.uniform(1.4, 2.5) * np.array([np.cos(angle), np.sin(angle)])
    paths = [numbers * step, numbers * (step + apart) + 3.0 * np.sin(numbers / 9.0) * np.array([1.0, 0.5])]
    share, light = rng.uniform(0.3, 0.5), 10.0 ** rng.uniform(-1.3, -0.5)
    first = travelling_frames(letter(), (330, 410), 128, rng, paths[0], 20.0)
    second = travelling_frames(letter(size=16).T, (330, 410), 128, rng, paths[1], 20.0)
    both = [(1.0 - share) * a + share * b for a, b in zip(first, second, strict=True)]
    found = track(cg.Capture([rng.poisson(light * frame).astype(np.float32) for frame in both]))
    ends = [np.linalg.norm(one.path_pixels[-1] - paths[0][-1]) for one in (found, *found.others)]
    assert len(ends) == 2
    for truth, one in zip(paths, (found, *found.others)[:: 1 if ends[0] < ends[1] else -1], strict=True):
        deviation = one.path_pixels - truth
        assert np.sqrt(np.mean(np.square(deviation[1:] / one.error_pixels[1:]))) < 3.5
        assert np.abs(deviation).max() < 9.0  # they end 55 to 100 pixels apart


@pytest.mark.slow
def test_errors_of_a_long_path_in_faint_light_add_up_once(rng):
    """Noise of a pair of frames moves both in opposite directions, so that errors grow like the root of the number of frames, as
    stated. What the illumination changes adds to the bends by the noise of the photons; the slower, the less."""
    numbers = np.arange(400)[:, None]
    path = numbers * np.array([1.3, -2.1]) + 6.0 * np.sin(numbers / 20.0) * np.array([0.4, 1.0])
    squares, bends, smooth = [], {12.0: [], 100.0: []}, []
    for memory in (12.0, 12.0, 100.0, 100.0):
        frames = travelling_frames(letter(), (330, 410), 128, rng, path, memory)
        found = track(cg.Capture([rng.poisson(0.004 * frame).astype(np.float32) for frame in frames]))
        assert found.frames_per_position == 1
        squares.append(np.mean(np.square((found.path_pixels - path)[1:] / found.error_pixels[1:])))
        bends[memory].append(np.mean(np.square(np.diff(found.path_pixels, 2, axis=0) / found.bend_error_pixels)))
        smooth.append([np.diff(one - path, axis=0).std() for one in (found.smooth_path_pixels, found.path_pixels)])
    assert 0.1 < np.mean(squares[:2]) < 2.5
    assert 0.02 < np.mean(squares[2:]) < 1.0  # the stated error allows for a faster change
    assert np.mean(bends[12.0]) == pytest.approx(1.15, abs=0.25)
    assert np.mean(bends[100.0]) == pytest.approx(1.0, abs=0.15)
    assert all(one < 0.3 * other for one, other in smooth)


def test_a_path_is_smoothed_only_where_noise_may_have_bent_it(rng):
    """A vibration far above the noise stays, a straight path becomes straight."""
    numbers = np.arange(200)[:, None]
    shaken = numbers * np.array([0.3, -0.2]) + np.sin(1.3 * numbers) * np.array([1.0, 0.0])
    noise = np.cumsum(0.05 * rng.standard_normal((200, 2)), 0)
    path = shaken + noise - (shaken + noise)[0]
    found = Track(path, np.ones((200, 2)), 50.0, 1.0, noise=PathNoise(np.full(2, 0.05**2))).smooth_path_pixels
    steps, true = np.diff(found, axis=0), np.diff(shaken, axis=0)
    assert np.abs(steps - true)[:, 0].std() < 0.06
    assert (steps - true)[:, 1].std() < 0.5 * np.diff(noise, axis=0)[:, 1].std()
    np.testing.assert_allclose(Track(path, np.ones((200, 2)), 50.0, 1.0).smooth_path_pixels, path, atol=1e-4)


@pytest.mark.slow
def test_a_vibration_is_found_with_its_amplitude(rng):
    """A fifth of the frame rate, 0.4 pixels; and none in a path without."""
    numbers = np.arange(128)
    drift = np.outer(numbers, [0.05, -0.03])
    shaken = drift + np.outer(np.sin(2.0 * np.pi * 0.2 * numbers), [0.4, 0.1])
    found = track(cg.Capture(drifting(rng, shaken, 0.05)), interval_s=1e-3)
    first = found.vibrations[0]
    assert first["hz"] == pytest.approx(200.0, abs=4.0)
    assert first["amplitude_pixels"][0] == pytest.approx(0.4, abs=0.08)
    assert track(cg.Capture(drifting(rng, drift, 0.05)), interval_s=1e-3).vibrations == []


def test_missing_frames_are_counted_by_their_numbers(rng, tmp_path):
    """Files 4, 5 and 9 of fifteen are lost: step, velocity and times are those of all fifteen."""
    kept = [number for number in range(15) if number not in (4, 5, 9)]
    step = np.array((2.0, -3.0))
    frames = drifting(rng, np.arange(15)[:, None] * step, 0.1)
    camera = cg.CameraMetadata(532e-9, 80e-6, 1.0)
    capture = cg.Capture([frames[number] for number in kept], camera, tuple(f"run_7_{number:03}.tif" for number in kept))
    found = track(capture, source_distance_m=0.5, interval_s=1e-2)
    np.testing.assert_allclose(found.step_pixels, step, atol=0.03)
    np.testing.assert_allclose(found.velocity_m_s, found.metres_per_pixel @ found.step_pixels / 1e-2)
    assert "3 of 15 frames are missing, the first after 4 frames" in found.warnings[0]
    found.save(tmp_path)
    table = np.genfromtxt(tmp_path / "track.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["time_s"], np.array(kept) * 1e-2)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("a10.tif", "a20.tif", "a40.tif"), (0, 1, 3)),  # every tenth is kept, and one of these is lost
        (("a1_7.tif", "a2_9.tif", "a4_13.tif"), (0, 1, 3)),  # two numbers that agree
        (("a1_7.tif", "a2_9.tif", "a4_11.tif"), (0, 1, 2)),
        (("a1_7.tif", "a1_9.tif", "a2_13.tif"), (0, 1, 3)),  # the other does not count
        (("a3.tif", "a2.tif", "a1.tif"), (0, 1, 2)),
        (("t1041.tif", "t1083.tif", "t1124.tif"), (0, 1, 2)),  # times
        (("a.tif", "b.tif", "c.tif"), (0, 1, 2)),
        (("a1.tif", "b2.tif", "c4.tif"), (0, 1, 2)),
        (("x" + 30 * "9" + ".tif", "x1.tif", "x2.tif"), (0, 1, 2)),
        (("stack.tif",), (0, 1, 2)),
    ],
)
def test_numbers_of_frames_come_from_names_that_tell_them(names, expected):
    capture = cg.Capture(list(np.zeros((3, 70, 70), np.float32)), names=names)
    np.testing.assert_array_equal(frame_numbers(capture), expected)


@pytest.mark.parametrize(
    ("names", "is_certain"),
    [
        (("f_08.tif", "f_09.tif", "f_10.tif"), True),
        (("a1_7.tif", "a1_9.tif", "a2_13.tif"), True),
        (("t_0.00.tif", "t_0.25.tif", "t_0.50.tif"), True),
        (("stack.tif",), True),
        (("run-0002.tif", "run-0001.tif", "run0000.tif"), False),  # negative numbers
        (("f (1).tif", "f (2).tif", "f.tif"), False),
        (("t_0.5.tif", "t_0.25.tif", "t_0.75.tif"), False),
        (("F_00.tif", "f_01.tif", "f_02.tif"), False),
        (("f_09.tif", "f_0a.tif", "f_0b.tif"), False),
        (("f_3.tif", "f_2.tif", "f_1.tif"), False),
    ],
)
def test_names_that_do_not_tell_their_order_are_doubted(names, is_certain):
    assert (doubts_of_order(names) == []) == is_certain


def test_names_in_the_order_of_text_are_refused():
    capture = cg.Capture(list(np.zeros((3, 70, 70), np.float32)), names=("f1.tif", "f10.tif", "f2.tif"))
    with pytest.raises(cg.InputError, match=r"f2.tif after f10.tif"):
        frame_numbers(capture)
