"""Frames that follow a moving object: exact sums of rigid speckle, and the gain in faint light, by an independent generator."""

import numpy as np
import pytest

import correlograph as cg
from invert.measure.estimate import estimate_from_frames
from invert.measure.spectrum import read_measurement
from invert.pipeline import fulfil
from invert.request import Request
from invert.tracking.stabilise import _Adder, estimate_along, follow_travel, stabilise
from invert.tracking.track import Track
from invert.tracking.travel import find_travel, may_travel
from tests.invert.field.speckle import expected_frame, letter, travelling_frames

SHAPE, PATCH = (330, 410), 128


def path_of(frames, step):
    """Return a curved path (frames, 2) with a mean step in pixels."""
    along = np.arange(frames)
    return along[:, None] * np.array(step) + 6.0 * np.sin(along / 9.0)[:, None] * np.array([0.4, 1.0])


def dim_frames(rng, light, frames=48, memory=5.0):
    path = path_of(frames, (1.3, -2.1))
    return [rng.poisson(light * one).astype(np.float32) for one in travelling_frames(letter(), SHAPE, PATCH, rng, path, memory)]


def significance(capture):
    return read_measurement(estimate_from_frames(capture, Request(mean_model="pooled")).values).detection


def test_frames_of_rigid_speckle_add_up_to_the_middle_one(rng):
    """Speckle that moves by whole pixels: groups of frames are exactly their middle frame, times their number."""
    wall = expected_frame(letter(), (460, 520), PATCH, rng)
    path = np.rint(path_of(16, (2.0, -3.0))).astype(int)
    frames = [wall[60 - down : 360 - down, 80 - right : 400 - right].astype(np.float32) for down, right in path]
    found = stabilise(cg.Capture(frames), Track(path.astype(float), np.ones(path.shape), 50.0, 1.0))
    assert found.size > 1
    for group, added in enumerate(found.capture.frames):
        (rows, columns), middle = added.shape, frames[group * found.size + found.size // 2]
        matches = [
            np.array_equal(added, found.size * middle[top : top + rows, left : left + columns])
            for top in range(301 - rows)
            for left in range(321 - columns)
        ]
        assert sum(matches) == 1, group
    np.testing.assert_array_equal(found.middle_frame, found.size * np.arange(16 // found.size) + 0.5 * (found.size - 1))


def test_sums_of_integers_do_not_overflow(rng):
    path = np.zeros((8, 2))
    frames = [np.full((300, 300), 200, np.uint8) + rng.integers(0, 50, (300, 300), np.uint8) for _ in range(8)]
    groups = [range(4), range(4, 8)]
    np.testing.assert_array_equal(
        _Adder(cg.Capture(frames)).add(path, groups).frames[1], np.sum(frames[4:], 0, dtype=np.float32)
    )


def test_a_way_that_leaves_the_frame_ends_the_search_for_larger_groups(rng):
    """Groups of eight frames would have no pixel in common."""
    wall = expected_frame(letter(), (300, 2000), PATCH, rng)
    frames = [rng.poisson(0.05 * wall[:, 60 * number : 60 * number + 300]).astype(np.float32) for number in range(24)]
    path = np.arange(24)[:, None] * np.array([0.0, -60.0])
    found = stabilise(cg.Capture(frames), Track(path, np.ones(path.shape), 50.0, 1.0))
    assert found.size in (1, 2, 4)
    assert found.track is not None


@pytest.mark.slow
def test_faint_frames_that_follow_the_object_show_it_more_clearly(rng):
    """The gain in significance of groups of four is about the root of their number, less what the changing illumination takes: 1.29 on
    average, with a standard deviation of 0.06."""
    gains = []
    for _ in range(4):
        capture = cg.Capture(dim_frames(rng, 0.05))
        found = follow_travel(capture, estimate_from_frames(capture).filtered_frames)
        assert found.size in (2, 4, 8)
        gains.append(significance(found.capture) / significance(capture))
        total = sum(float(frame.sum()) for frame in found.capture.frames)
        assert total == round(total)  # photoelectrons stay whole
    assert np.mean(gains) > 1.2


@pytest.mark.slow
def test_the_pipeline_follows_an_object_and_says_so(rng):
    capture = cg.Capture(dim_frames(rng, 0.3, frames=16))
    result = fulfil(Request(quality="fast", blur_pixels=0.0), capture)
    assert any("groups of" in note for note in result.notes)
    assert result.estimate.record.frames < 16


def test_independent_frames_share_no_pattern(rng):
    frames = [rng.poisson(0.5 * expected_frame(letter(), SHAPE, PATCH, rng)).astype(np.float32) for _ in range(6)]
    assert not may_travel(estimate_from_frames(cg.Capture(frames)).filtered_frames.spectra)


def test_speckle_at_rest_does_not_travel(rng):
    wall = expected_frame(letter(), SHAPE, PATCH, rng)
    capture = cg.Capture([rng.poisson(0.5 * wall).astype(np.float32) for _ in range(6)])
    assert may_travel(estimate_from_frames(capture).filtered_frames.spectra)
    assert find_travel(capture) is None


@pytest.mark.parametrize("kind", ["shake", "circle", "vibration", "rest"])
def test_a_pattern_that_moves_to_and_fro_is_added_along_its_path(kind):
    """Two pixels rms, a closed circle of 20 pixels, a vibration of 9, and faint light at rest; five draws, because one pattern of speckle
    changes an image by 0.07.

    Before, the images correlated with the letter by 0.3 to 0.6, because the mean of all frames was taken, or because what they share was
    subtracted. One frame of the same light shows what the pattern allows.
    """
    gains, excesses = [], []
    for seed in range(1, 6):
        moving, still = to_and_fro(kind, np.random.default_rng(seed))
        (correlation, confidence), (possible, _) = (image_of_letter(frames) for frames in (moving, [still]))
        gains.append(correlation - possible)
        excesses.append(confidence - correlation)
    assert np.mean(gains) > -0.1
    assert np.abs(np.mean(excesses)) < 0.1
    assert np.abs(excesses).max() < 0.25


def to_and_fro(kind, rng):
    """Sixteen frames of a letter whose speckle moves to and fro, and one at rest of their light."""
    numbers = np.arange(16)[:, None]
    turn = 2.0 * np.pi * numbers / 15.0
    away = {
        "shake": 2.0 * rng.standard_normal((16, 2)),
        "circle": 10.0 * np.hstack([np.cos(turn), np.sin(turn)]),
        "vibration": np.sin(0.46 * np.pi * numbers) * np.array([8.0, 4.0]),
        "rest": np.zeros((16, 2)),
    }[kind]
    places, light = np.round(away - away.min(0)).astype(int), 0.03 if kind == "rest" else 0.1
    wall = expected_frame(letter(64, 26), (380, 410), PATCH, rng)
    cropped = [wall[row : row + 320, column : column + 350] for row, column in places]
    still = rng.poisson(16.0 * light * cropped[0]).astype(np.float32)
    return [rng.poisson(light * one).astype(np.float32) for one in cropped], still


def image_of_letter(frames):
    """Correlation of the image from frames with the letter, and its confidence."""
    result = fulfil(Request(quality="fast", blur_pixels=0.0), cg.Capture(frames))
    shown, truth = (one.astype(np.float32) for one in (result.albedo, letter(64, 26)))
    return float(cg.aligned_pearson(shown, truth)[0]), result.confidence


def test_the_error_of_a_path_blurs_the_speckle_of_its_groups(rng):
    """Rigid speckle in groups of 16 frames along a path with white errors of 1.5 and 0.8 pixels: r*r falls as the blur by these says."""
    frames, errors = 16, np.rint(rng.normal(0.0, (1.5, 0.8), (64, 2))).astype(int)
    wall = [expected_frame(letter(), (460, 520), PATCH, rng).astype(np.float32) for _ in range(4)]
    sums = {}
    for name, off in (("exact", np.zeros_like(errors)), ("wrong", errors)):
        added = [
            sum(
                one[60 + down : 360 + down, 80 + right : 400 + right]
                for down, right in off[frames * number : frames * (number + 1)]
            )
            for number, one in enumerate(wall)
        ]
        sums[name] = cg.Capture(added)
    spread = tuple(float(one) for one in errors.reshape(4, frames, 2).std(1).mean(0))
    exact, blurred = (estimate_along(sums[name], Request(mean_model="pooled"), spread) for name in ("exact", "wrong"))
    clear = (exact.transfer > 0.2) & (exact.transfer < 0.8) & (exact.values > 0.1 * exact.values.max())
    ratio = (blurred.values / exact.values)[clear]
    assert clear.sum() > 50
    assert np.median(ratio / exact.transfer[clear]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("seed", "light", "limit"), [(0, 0.004, 0.6), (3, 0.003, 0.8), (4, 0.003, 0.8), (1, 0.002, 1.2)])
def test_a_path_that_turns_every_twelve_frames_is_followed_in_faint_light(seed, light, limit):
    """Within groups of 32 frames, the smoothed path is right to a fraction of a pixel, and its error says so. Blocks of frames that are
    long enough to show a motion miss its turns, and its two directions look like two objects."""
    rng, numbers = np.random.default_rng(seed), np.arange(192)
    path = (np.abs((numbers + 12) % 24 - 12) - 12)[:, None] * np.array([1.2, -1.7])
    frames = travelling_frames(letter(64, 28), (320, 360), 128, rng, path, 200.0)
    track = cg.track(cg.Capture([rng.poisson(light * frame).astype(np.float32) for frame in frames]))
    assert not track.others
    away = (track.smooth_path_pixels - path).reshape(6, 32, 2)
    found = float(np.hypot(*np.sqrt(away.var(1).mean(0))))
    assert found < limit
    assert found < 1.5 * np.hypot(*track.error_in_groups(32))
