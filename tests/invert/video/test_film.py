"""Films: turning, pooling, windows of time, whole films from frames of an independent generator, files and refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import correlograph as cg
from correlograph.errors import InputError
from invert.__main__ import main as invert_command
from invert.albedo.registration import correlation_maps, zero_pad
from invert.measure.estimate import estimate_from_frames
from invert.request import Request
from invert.video.film import FILM_FILES
from invert.video.looks import Looks
from invert.video.pooling import pool
from invert.video.sequence import register_sequence
from invert.video.turning import turn
from invert.video.windows import Window, change, choose_window
from tests.invert.field.speckle import expected_frame, letter, travelling_frames
from tests.invert.test_rotation import frames_of, turned


@pytest.mark.parametrize("aspect", [1.0, 1.2])
def test_a_turned_albedo_is_that_of_the_turned_object(aspect):
    """Anticlockwise on the screen, with rows `aspect` times as far apart as columns."""
    for angle in (25.0, -70.0):
        shown = turn(turned(0.0, aspect=aspect), angle, aspect)
        expected = turned(angle, aspect=aspect)
        assert np.corrcoef(shown.ravel(), expected.ravel())[0, 1] > 0.97
        assert np.corrcoef(shown.ravel(), turned(-angle, aspect=aspect).ravel())[0, 1] < 0.6


def test_middles_cover_the_capture_without_gaps():
    window = Window(4, 40)
    middles = window.middles()
    assert (middles[0], middles[-1]) == (4, 35)
    assert max(np.diff(middles)) <= 4
    assert all(len(range(40)[window.around(one)]) == 9 for one in middles)
    assert Window(40, 40).middles() == [20]
    assert Window(40, 40).around(20) == slice(0, 61)


def looks_from(capture):
    return Looks.of(capture, estimate_from_frames(capture), Request())


def looks_of(values):
    """Return looks on 63 x 63 lags without metadata but for their number."""
    capture = cg.Capture([np.random.default_rng(number).poisson(2.0, (300, 300)).astype(np.float32) for number in range(2)])
    whole = estimate_from_frames(capture, Request(lags=32))
    record = replace(whole.record, frames=len(values), dof_expected=20.0 * len(values))
    count = len(values)
    return Looks(values, replace(whole, record=record), np.zeros(count), np.ones(count), np.zeros(count, bool))


def gamma_noise(rng, mean, dof=20.0):
    """Return symmetric lags of Gamma noise around a mean (frames, n, n); each lag is independent, as if the inflation were 1."""
    noisy = rng.gamma(dof, mean / dof)
    half = noisy.shape[-1] // 2
    noisy[:, half + 1 :] = noisy[:, :half][:, ::-1, ::-1]
    noisy[:, half, half + 1 :] = noisy[:, half, :half][:, ::-1]
    return noisy


def test_the_change_is_that_of_the_closed_form(rng):
    """A quadratic change c t^2 of every lag: the mean over a window of h is off by c h^2 / 3, which costs K / 2 (c h^2 / 3)^2 nats per lag
    and frame of the window, K the effective degrees of freedom."""
    time, half, slope = np.arange(-30, 31), 12, 4e-4
    mean = 1.0 + slope * time[:, None, None] ** 2 * np.ones((1, 65, 65))
    mean /= mean[30]
    near = looks_of(gamma_noise(rng, mean))
    found, error = change(near, near.values, half)
    lags = near.whole.lag_grid.off_axis.sum()
    # relative to the level at each time, which the frames outside the middle have already reached
    level = (slope * half**2 / 3.0) / mean[half:-half, 0, 0]
    expected = 0.5 * 20.0 / 2.25 * (2 * half + 1) * lags * np.mean(level**2)
    assert found == pytest.approx(expected, abs=4.0 * error, rel=0.15)
    assert error < 0.5 * expected


def test_lags_that_stay_the_same_share_one_window(rng):
    """The limit is exceeded falsely by two standard errors, at most in one of forty tries of a half-width."""
    every = [choose_window(looks_of(gamma_noise(rng, np.ones((32, 65, 65))))).holds_all for _ in range(4)]
    assert sum(every) >= 3


def symmetric(rng):
    """A pattern of lags from 0 to 1, (65, 65)."""
    half = rng.random((65, 65))
    return 0.5 * (half + half[::-1, ::-1])


def test_lags_that_stay_the_same_are_pooled_equally(rng):
    for frames in (8, 12, 32, 64, 100):
        pooling = pool(looks_of(gamma_noise(rng, np.full((frames, 65, 65), 2.0))))
        assert pooling.patterns == 0
        assert not pooling.doubts[0].is_raised
        np.testing.assert_allclose(pooling.weights, 1.0 / frames)
        assert pooling.times(48).tolist() == [frames // 2]


def test_lags_that_swing_between_two_states_are_pooled_over_all_swings(rng):
    """One pattern with a course u in time: the weights are 1 / n + u u^T, so that an image at its usual distance from the mean has the
    noise of n / 2 frames, and no bias."""
    time, pattern = np.arange(48), symmetric(rng)
    mean = 2.0 + np.sin(time / 3.0)[:, None, None] * pattern
    pooling = pool(looks_of(gamma_noise(rng, mean)))
    assert pooling.patterns == 1
    np.testing.assert_allclose(pooling.weights.sum(1), 1.0, atol=1e-6)
    assert pooling.frames == pytest.approx(48 / 2, rel=0.35)
    course = np.sin(time / 3.0) - np.sin(time / 3.0).mean()
    expected = 1.0 / 48 + np.outer(course, course) / (course @ course)
    np.testing.assert_allclose(pooling.weights, expected, atol=0.02)


def signal():
    """r*r of an object above a floor of 1, (65, 65): lags beyond it show the noise."""
    rows, columns = np.indices((65, 65)) - 32.0
    return np.maximum(2.0 - np.hypot(rows, columns) / 8.0, 0.0)


def test_an_object_that_is_another_in_each_frame_is_not_pooled(rng):
    """The noise is known from theory: where all patterns exceed it, none shows its level. Once, the median of all patterns was taken for
    it, and eight letters were shown as one image at rest."""
    for frames in (8, 16):
        mean = 1.0 + 3.0 * signal() * np.stack([symmetric(rng) > 0.5 for _ in range(frames)])
        pooling = pool(looks_of(gamma_noise(rng, mean)))
        assert pooling.patterns >= frames - 2  # the mean over time is the last one
        assert pooling.frames < 1.5
        assert not pooling.has_one_image


def test_a_change_too_faint_for_patterns_is_told(rng):
    """Each frame has a pattern of its own; it raises the variance of r*r over time above its noise, 1 / 20 of the square."""
    half = 0.15 * rng.standard_normal((16, 65, 65))
    mean = 1.0 + signal()
    pooling = pool(looks_of(gamma_noise(rng, mean * (1.0 + 0.5**0.5 * (half + half[:, ::-1, ::-1]) * (signal() > 0.0)))))
    assert pooling.patterns == 0
    assert pooling.doubts[0].is_raised
    assert pooling.doubts[0].value == pytest.approx(20.0 * 0.15**2, rel=0.3)


def test_a_short_change_leaves_the_other_frames_pooled(rng):
    """Three of 48 frames differ."""
    mean = np.full((48, 65, 65), 2.0)
    mean[20:23] += symmetric(rng)
    pooling = pool(looks_of(gamma_noise(rng, mean)))
    assert pooling.patterns == 1
    assert 1.0 / (pooling.weights[21] ** 2).sum() == pytest.approx(3.0, rel=0.35)
    assert 1.0 / (pooling.weights[5] ** 2).sum() == pytest.approx(45.0, rel=0.1)


def test_images_are_turned_alike_though_some_are_symmetric(rng):
    """An F that fades to a bar and back, each image at its own place and by chance turned, with errors of a twentieth."""
    f, bar = (np.zeros((64, 64), np.float32) for _ in range(2))
    f[20:40, 24:27] = f[20:23, 24:38] = f[29:32, 24:34] = 1.0
    bar[20:40, 24:27] = 1.0
    truth = np.stack([share * f + (1.0 - share) * bar for share in 0.5 + 0.5 * np.cos(np.arange(24) / 2.0)])
    shown = []
    for number, one in enumerate(truth):
        noisy = (one + 0.05 * rng.standard_normal(one.shape)).clip(0.0)
        turned_by_chance = noisy[::-1, ::-1] if number and rng.random() < 0.5 else noisy
        shown.append(np.roll(turned_by_chance, rng.integers(-5, 6, 2) if number else (0, 0), (0, 1)))
    found = register_sequence(np.array(shown))
    is_clear = np.cos(np.arange(24) / 2.0) > -0.8
    for one, expected in zip(found[is_clear], truth[is_clear], strict=True):
        maps = correlation_maps(*(zero_pad(torch.from_numpy(image)) for image in (one[None], expected)))[0]
        upright, upside_down = maps.amax((-2, -1)).tolist()
        assert upright > max(0.9, upside_down)
    places = np.array([np.average(np.indices((64, 64)), axis=(1, 2), weights=np.where(one > 0.5, one, 0.0)) for one in found])
    assert np.ptp(places[is_clear], axis=0).max() < 3.0  # the arms of the F move its centre


@pytest.mark.slow
def test_the_window_of_a_fast_object_is_shorter(rng):
    widths = []
    for turn_deg in (20.0, 90.0):
        capture = cg.Capture(frames_of(np.linspace(0.0, turn_deg, 40), 0.1, rng))
        widths.append(choose_window(looks_from(capture)).half_width)
    assert 2 <= widths[1] < widths[0]
    assert widths[1] <= 8  # 18 degrees on either side


@pytest.mark.slow
def test_a_turning_letter_is_pooled_over_all_frames(rng, tmp_path):
    angles = np.linspace(0.0, 90.0, 40)
    found = cg.film(cg.Capture(frames_of(angles, 0.1, rng)), interval_s=0.1, quality="fast", blur_pixels=0.0)
    assert found.frames_per_image == 40
    for number in (0, 20, 39):
        truth = turned(angles[number]).astype(np.float32)
        assert cg.aligned_pearson(found.albedos[number], truth)[0] > 0.9
    assert found.angle_deg[-1] == pytest.approx(90.0, abs=3.0)
    found.save(tmp_path)
    table = np.genfromtxt(tmp_path / "film.csv", delimiter=",", names=True)
    assert table.dtype.names == ("frame", "time_s", "confidence", "angle_deg")
    np.testing.assert_allclose(table["angle_deg"], found.angle_deg, rtol=1e-6)
    assert np.load(tmp_path / "film.npy").shape == (40, 64, 64)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames >= 30
        assert film.info["duration"] == pytest.approx(1000 * 3.9 / 40, abs=10)
    assert json.loads((tmp_path / "film.json").read_text())["turn_deg"] == pytest.approx(90.0, abs=3.0)


@pytest.mark.slow
def test_a_moving_object_has_path_and_image(rng):
    path = np.arange(48)[:, None] * np.array([1.3, -2.1])
    frames = [rng.poisson(0.2 * one).astype(np.float32) for one in travelling_frames(letter(), (330, 410), 128, rng, path, 6.0)]
    found = cg.film(cg.Capture(frames), quality="fast", blur_pixels=0.0)
    assert {"row_pixels", "column_pixels"} <= found.columns().keys()
    assert found.columns()["column_pixels"] == pytest.approx(-2.1 * found.middle_frame, abs=3.0)
    assert found.path.step_pixels == pytest.approx([1.3, -2.1], rel=0.1)
    assert any("groups of" in note for note in found.notes)
    assert cg.aligned_pearson(found.albedos[0], letter().astype(np.float32))[0] > 0.75


@pytest.mark.slow
def test_images_from_fields_are_finer_where_the_light_suffices(rng):
    """Eight frames of a letter at rest; in the second film they are so faint that each image stays coarse, which one note says."""
    frames = [expected_frame(letter(), (400, 452), 128, rng) for _ in range(8)]
    options = {"method": "field", "quality": "fast", "patch": 128, "blur_pixels": 0.0}
    bright = cg.film(np.stack([rng.poisson(2.0 * one) for one in frames]), **options)
    assert bright.albedos.shape[1] > 64
    truth = np.kron(letter(), np.ones((bright.albedos.shape[1] // 64,) * 2)).astype(np.float32)
    assert min(cg.aligned_pearson(one, truth)[0] for one in bright.albedos) > 0.95
    faint = cg.film(np.stack([rng.poisson(0.02 * one) for one in frames]), **options)
    assert faint.albedos.shape[1] == 64
    count = len(faint.albedos)
    assert [f"{count} of {count} images show the coarse albedo" in note for note in faint.notes].count(True) == 1


@pytest.mark.slow
def test_the_command_writes_a_film(command, tmp_path, rng):
    np.save(tmp_path / "frames.npy", np.stack(frames_of(np.linspace(0.0, 40.0, 12), 1.0, rng)))
    options = ("--video", "--frames-per-s", "8", "--quality", "fast", "--blur-pixels", "0")
    code, out, _ = command(invert_command, tmp_path / "frames.npy", "-o", tmp_path / "out", *options)
    assert code == 0
    assert "film.gif" in out
    names = {"film.gif", "film.png", "film.csv", "film.json", "film.npy"}
    assert names <= {path.name for path in (tmp_path / "out").iterdir()}


def test_a_film_of_a_slow_camera_is_written(tmp_path):
    """A frame in twenty minutes: a GIF holds at most eleven for a picture."""
    film = cg.Film(
        np.random.default_rng(1).random((2, 16, 16), np.float32), np.array([0.0, 9.0]), np.full(2, 0.9), 4, interval_s=1200.0
    )
    film.save(tmp_path)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.info["duration"] == 655_350


def test_times_without_light_show_nothing():
    """The second half is dark. Remains of the letter there once appeared as a ghost, at a confidence of 0.5 to 0.7."""
    rng = np.random.default_rng(4)
    seen = [rng.poisson(0.1 * expected_frame(letter(), (300, 330), 128, rng)).astype(np.float32) for _ in range(8)]
    film = cg.film(cg.Capture([*seen, *(np.zeros((300, 330), np.float32) for _ in range(8))]), quality="fast", blur_pixels=0)
    assert len(film.albedos) == 16
    assert (film.confidence[:8] > 0.5).all()
    assert not film.confidence[8:].any()
    assert not film.albedos[8:].any()


def test_an_interrupted_film_leaves_the_one_before(tmp_path, monkeypatch):
    """All files are replaced at the end."""
    one = cg.Film(np.zeros((2, 16, 16), np.float32), np.array([0.0, 9.0]), np.full(2, 0.9), 4)
    one.save(tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in FILM_FILES}

    def interrupt(path):
        raise KeyboardInterrupt

    another = replace(one, albedos=np.ones((2, 16, 16), np.float32))
    monkeypatch.setattr(another.__class__, "_save_gif", lambda self, path: interrupt(path))
    with pytest.raises(KeyboardInterrupt):
        another.save(tmp_path)
    assert {name: (tmp_path / name).read_bytes() for name in FILM_FILES} == before


def test_unsuitable_frames_and_options_are_refused(command, tmp_path, rng):
    frames = rng.poisson(2.0, (7, 300, 300)).astype(np.float32)
    with pytest.raises(InputError, match="8 or more for a film"):
        cg.film(cg.Capture(list(frames)))
    with pytest.raises(InputError, match="two patches"):
        cg.film(cg.Capture(list(rng.poisson(2.0, (8, 240, 240)).astype(np.float32))))
    with pytest.raises(InputError, match="found none in frame 9"):
        cg.film([*(5.0 * expected_frame(letter(), (300, 300), 128, rng) for _ in range(9)), np.zeros((300, 300))])
    with pytest.raises(InputError, match="found zeros"):
        cg.film([np.zeros((300, 300))] * 9)
    with pytest.raises(InputError, match="auto, pooled or fixed"):
        cg.film(cg.Capture([*frames, *frames]), mean_model="published")
    with pytest.raises(InputError, match="an autocorrelation"):
        cg.film(np.ones((127, 127), np.float32))
    np.save(tmp_path / "frames.npy", frames)
    for options in (
        ["--video", "--autocorrelation"],
        ["--video", "--save-fields", "--method", "field"],
        ["--frames-per-s", "3"],
    ):
        code, _, error = command(invert_command, tmp_path / "frames.npy", "-o", tmp_path / "out", *options)
        assert code == 2
        assert "remove" in error


def drifting_light(rng, angles, factor):
    """Frames of a letter at angles in degrees, while its light rises by a factor."""
    light = 0.5 * factor ** np.linspace(-0.5, 0.5, len(angles))
    shown = (turned(angle) for angle in angles)
    frames = [one * expected_frame(albedo, (300, 330), 128, rng) for one, albedo in zip(light, shown, strict=True)]
    return cg.Capture([rng.poisson(one).astype(np.float32) for one in frames])


@pytest.mark.parametrize("factor", [1.0, 3.0, 10.0])
def test_light_that_drifts_is_no_change_of_the_object(rng, factor):
    """Frames of an object at rest are pooled by their noise: a frame of less light has more."""
    looks = looks_from(drifting_light(rng, np.zeros(16), factor))
    pooling = pool(looks)
    assert pooling.patterns == 0
    np.testing.assert_allclose(pooling.weights[3], looks.noise**-2.0 / 16.0, rtol=1e-5)
    assert factor**0.3 < 1.2 * looks.noise[0] / looks.noise[-1] < 1.44 * factor


@pytest.mark.parametrize("factor", [3.0, 0.1])
def test_light_that_drifts_hides_no_rotation(rng, factor):
    found = cg.track_rotation(drifting_light(rng, 4.0 * np.arange(24), factor))
    turned_by = 4.0 * (found.middle_frame - found.middle_frame[0])
    np.testing.assert_allclose(found.angle_deg, turned_by, atol=4.0 * found.angle_error_deg)
    assert found.angle_error_deg < 1.5


def test_an_object_at_rest_under_a_laser_at_rest_is_one_image(rng):
    wall = expected_frame(letter(64, 26), (320, 350), 128, rng)
    film = cg.film(cg.Capture([rng.poisson(0.2 * wall).astype(np.float32) for _ in range(10)]), quality="fast", blur_pixels=0)
    assert len(film.albedos) == 1
    assert any("one speckle pattern" in note for note in film.notes)
    correlation = float(cg.aligned_pearson(film.albedos[0], letter(64, 26).astype(np.float32))[0])
    assert correlation > 0.7


def test_dark_frames_have_no_weight(rng):
    """Four of sixteen frames have a hundredth of the light, or none."""
    capture = drifting_light(rng, np.zeros(16), 1.0)
    for number, light in ((3, 0.0), (4, 0.0), (5, 0.01), (6, 0.01)):
        capture.frames[number][:] = rng.binomial(capture.frames[number].astype(int), light)
    looks = looks_from(capture)
    assert np.flatnonzero(looks.are_dark).tolist() == [3, 4, 5, 6]
    pooling = pool(looks)
    assert pooling.patterns == 0
    assert pooling.weights[8, 3:7].max() < 1e-3
    np.testing.assert_allclose(pooling.weights[8, [0, 1, 2, 7, 8, 9]], 1.0 / 12.0, rtol=0.2)


def test_static_light_that_drifts_with_the_laser_leaves_numbers(rng):
    """A fine pattern of 3 % on the sensor, while the light rises by three; before, the floors of dim frames were below zero."""
    capture, pattern = drifting_light(rng, np.zeros(8), 3.0), 1.0 + 0.03 * rng.standard_normal((300, 330))
    frames = [rng.poisson(100.0 * frame * pattern).astype(np.float32) for frame in capture.frames]
    looks = looks_from(cg.Capture(frames))
    assert np.isfinite(looks.values).all()
    assert looks.floors.min() > 0.0
    assert np.isfinite(pool(looks).weights).all()
