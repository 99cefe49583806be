"""Live view of an object that moves while the laser is at rest: its path through all windows, its images, the film."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

import correlograph as cg
from correlograph.files.corrections import Corrections
from correlograph.live.film import MAX_IMAGES, LiveFilm, Look
from correlograph.live.page import pictures
from correlograph.live.session import LiveSession
from correlograph.live.threads import Acquisition
from invert.tracking.track import Track
from tests.invert.field.speckle import letter, travelling_frames

SHAPE, STEP = (420, 460), np.array([3.0, -2.0])


@pytest.fixture(scope="module")
def look():
    """A reconstruction from eight moving frames."""
    return reconstructed(moving(8, 1.0))


def moving(count, light=0.5, seed=5):
    """Return frames of a letter that moves."""
    rng = np.random.default_rng(seed)
    frames = travelling_frames(letter(), SHAPE, 128, rng, np.arange(count)[:, None] * STEP, 200.0)
    return [rng.poisson(light * frame).astype(np.float32) for frame in frames]


def reconstructed(frames, session=None):
    session = session or LiveSession(cg.CameraMetadata())
    for number, frame in enumerate(frames):
        session.add(frame, number)
    return session.reconstruct(session.estimate(), "fast")


def shown(look, numbers, path, error):
    track = Track(np.asarray(path, float), np.asarray(error, float), 20.0, 0.9)
    return Look(replace(look.result, track=track), np.asarray(numbers))


def test_frames_are_added_along_the_path(look):
    assert look.result.track.step_pixels == pytest.approx(STEP, abs=0.1)
    assert look.result.compare(letter()).pearson > 0.8
    assert look.numbers.tolist() == list(range(8))
    assert look.middle == 3.5
    assert not any("camera" in warning for warning in look.result.warnings)


def test_motion_is_found_whenever_it_begins_and_empty_frames_are_left_out(rng):
    """Frames without light come first; a later one is dark."""
    frames = [rng.poisson(0.5, SHAPE).astype(np.float32) for _ in range(10)] + moving(24)
    frames[20] = rng.poisson(0.002, SHAPE).astype(np.float32)
    late = reconstructed(frames)
    assert late.numbers.tolist() == [number for number in range(10, 34) if number != 20]
    assert late.result.track.path_pixels[-1] == pytest.approx(23 * STEP, abs=2.0)
    film = LiveFilm()
    for _ in range(2):
        film.add(late)
    assert film.film(None).path.frame_numbers.tolist() == [number for number in range(24) if number != 10]


def test_a_dark_frame_and_a_restart(tmp_path):
    dark = np.random.default_rng(1).integers(0, 6, SHAPE).astype(np.float32)
    np.save(tmp_path / "dark.npy", dark)
    session = LiveSession(cg.CameraMetadata(), corrections=Corrections(dark=tmp_path / "dark.npy"))
    assert reconstructed([frame + dark for frame in moving(12, 5.0)], session).result.track.step_pixels == pytest.approx(
        STEP, abs=0.1
    )
    estimate = session.estimate()
    session.restart()
    assert session.reconstruct(estimate, "fast") is None


def test_windows_that_overlap_make_one_path(look):
    """Frame 4 was dropped; the second window begins at its own zero, and its errors add to those of the first."""
    film = LiveFilm()
    film.add(shown(look, [0, 1, 2, 3], [[0, 0], [1, -2], [2, -4], [3, -6]], np.outer([0.0, 0.3, 0.3, 0.3], [1, 1])))
    film.add(shown(look, [2, 3, 5, 6], [[0, 0], [1, -2], [3, -6], [4, -8]], np.outer([0.0, 0.3, 0.5, 0.5], [1, 1])))
    found = film.film(0.1)
    seen = np.array([0, 1, 2, 3, 5, 6])
    np.testing.assert_array_equal(found.path.frame_numbers, seen)
    np.testing.assert_allclose(found.path.path_pixels, seen[:, None] * np.array([1.0, -2.0]))
    np.testing.assert_allclose(found.path.error_pixels[[0, 3, 4, 5], 0], [0.0, 0.3, 0.5, 0.5])
    np.testing.assert_allclose(found.middle_frame, [1.5, 4.0])
    np.testing.assert_allclose(found.columns()["row_pixels"], [1.5, 4.0])
    assert found.columns()["time_s"] == pytest.approx([0.15, 0.4])


def test_a_window_without_overlap_begins_a_new_path(look):
    """The image before it stays, but has no place on the path."""
    film = LiveFilm()
    film.add(shown(look, [0, 1, 2], np.zeros((3, 2)), np.zeros((3, 2))))
    film.add(shown(look, [9, 10, 11], [[0, 0], [1, 1], [2, 2]], np.zeros((3, 2))))
    found = film.film(None)
    np.testing.assert_allclose(found.path.path_pixels, [[0, 0], [1, 1], [2, 2]])
    np.testing.assert_allclose(found.middle_frame, [-8.0, 1.0])
    np.testing.assert_allclose(found.columns()["row_pixels"], [np.nan, 1.0])


def test_the_path_of_another_object_is_not_appended(look):
    film = LiveFilm()
    film.add(shown(look, range(6), np.arange(6)[:, None] * np.array([4.0, 4.0]), np.full((6, 2), 0.1)))
    film.add(shown(look, range(2, 8), np.arange(6)[:, None] * np.array([-3.0, 2.0]), np.full((6, 2), 0.1)))
    np.testing.assert_allclose(film.path.path_pixels, np.arange(6)[:, None] * np.array([-3.0, 2.0]))


def test_a_long_film_keeps_its_beginning_and_its_end(look):
    film = LiveFilm()
    for number in range(3 * MAX_IMAGES):
        film.add(Look(replace(look.result, track=None), np.array([number])))
    found = film.film(None)
    assert MAX_IMAGES // 2 <= len(found.albedos) < MAX_IMAGES
    np.testing.assert_array_equal(found.middle_frame, 4.0 * np.arange(len(found.albedos)))
    assert found.middle_frame[-1] > 3 * MAX_IMAGES - 5


def test_a_live_film_is_saved_with_path_and_picture(tmp_path):
    rng = np.random.default_rng(6)
    wide = travelling_frames(letter(), SHAPE, 128, rng, np.arange(24)[:, None] * STEP, 200.0)

    class Camera:
        camera = cg.CameraMetadata()

        def __iter__(self):
            for frame in wide:
                time.sleep(0.1)  # slower than frames are added
                yield rng.poisson(0.5 * frame).astype(np.uint8)

    acquisition = Acquisition(Camera(), LiveSession(Camera.camera))
    with pytest.raises(cg.InputError, match="none so far"):
        acquisition.save_film(tmp_path)
    acquisition.start()
    acquisition.join()
    folders = [acquisition.save_film(tmp_path) for _ in range(2)]
    assert [one.name for one in folders] == ["film_001", "film_002"]
    said = json.loads((folders[0] / "film.json").read_text())
    assert said["track"]["step_pixels"] == pytest.approx(STEP, abs=0.1)
    assert (folders[0] / "film.gif").stat().st_size > 1000
    assert "path" in pictures(acquisition)
