"""Live view of an object that moves while the laser is at rest: its path through all windows, its images, the film."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

import correlograph as cg
from correlograph.live.film import MAX_IMAGES, LiveFilm, Look
from correlograph.live.page import pictures
from correlograph.live.session import LiveSession
from correlograph.live.threads import Acquisition
from invert.tracking.track import Track
from tests.invert.field.speckle import letter, travelling_frames

SHAPE, STEP = (420, 460), np.array([3.0, -2.0])


@pytest.fixture(scope="module")
def looks():
    """A reconstruction from the first eight of twenty moving frames, as a look."""
    rng = np.random.default_rng(5)
    frames = travelling_frames(letter(), SHAPE, 128, rng, np.arange(8)[:, None] * STEP, 200.0)
    session = LiveSession(cg.CameraMetadata())
    for number, frame in enumerate(frames):
        session.add(rng.poisson(0.5 * frame), number)
    return session.reconstruct(session.estimate(), "fast")


def shown(look, numbers, path, error):
    track = Track(np.asarray(path, float), np.asarray(error, float), 20.0, 0.9)
    return Look(replace(look.result, track=track), np.asarray(numbers))


def test_frames_are_added_along_the_path(looks):
    assert looks.result.track.step_pixels == pytest.approx(STEP, abs=0.1)
    assert looks.result.compare(letter()).pearson > 0.8
    assert looks.numbers.tolist() == list(range(8))
    assert looks.middle == 3.5
    assert not any("camera" in warning for warning in looks.result.warnings)


def test_windows_that_overlap_make_one_path(looks):
    """Frame 4 was dropped; the second window begins at its own zero, and its errors add to those of the first."""
    film = LiveFilm()
    film.add(shown(looks, [0, 1, 2, 3], [[0, 0], [1, -2], [2, -4], [3, -6]], np.outer([0.0, 0.3, 0.3, 0.3], [1, 1])))
    film.add(shown(looks, [2, 3, 5, 6], [[0, 0], [1, -2], [3, -6], [4, -8]], np.outer([0.0, 0.3, 0.5, 0.5], [1, 1])))
    found = film.film(0.1)
    np.testing.assert_allclose(found.path.path_pixels, np.arange(7)[:, None] * np.array([1.0, -2.0]))
    np.testing.assert_allclose(found.path.error_pixels[[0, 3, 5, 6], 0], [0.0, 0.3, 0.5, 0.5])
    np.testing.assert_allclose(found.middle_frame, [1.5, 4.0])
    np.testing.assert_allclose(found.columns()["row_pixels"], [1.5, 4.0])
    assert found.columns()["time_s"] == pytest.approx([0.15, 0.4])


def test_a_window_without_overlap_begins_a_new_film(looks):
    film = LiveFilm()
    film.add(shown(looks, [0, 1, 2], np.zeros((3, 2)), np.zeros((3, 2))))
    film.add(shown(looks, [9, 10, 11], [[0, 0], [1, 1], [2, 2]], np.zeros((3, 2))))
    found = film.film(None)
    np.testing.assert_allclose(found.path.path_pixels, [[0, 0], [1, 1], [2, 2]])
    np.testing.assert_allclose(found.middle_frame, [1.0])


def test_a_long_film_keeps_its_beginning_and_its_end(looks):
    film = LiveFilm()
    for number in range(3 * MAX_IMAGES):
        film.add(Look(replace(looks.result, track=None), np.array([number])))
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
