"""Speckle of a moving object travels over the wall by u (1 + z / d1); the tracker finds it with honest errors."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
from invert.track import main
from invert.tracking.track import track
from sim.rendering import render_geometry

FRAMES = 10

SYSTEMATIC_PIXELS = 0.1
"""Error of a step in bright frames: the object moves through the speckle of its illumination, which alters its own (docs/tracking.md)."""


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
    rng = np.random.default_rng(seed)
    capture, exposure_s, expected = moving(lab, rng, 10.0 ** rng.uniform(-1.5, 0.0))
    found = track(capture, source_distance_m=lab.source_distance_m, interval_s=exposure_s)
    assert found.significance > 20.0
    np.testing.assert_array_less(np.abs(found.step_pixels - expected), 4.0 * found.step_error_pixels + SYSTEMATIC_PIXELS)
    np.testing.assert_allclose(found.path_pixels, np.arange(FRAMES)[:, None] * expected, atol=FRAMES * SYSTEMATIC_PIXELS)
    np.testing.assert_allclose(
        found.velocity_m_s, expected * np.array(found.metres_per_pixel) / exposure_s, atol=2e-6 / exposure_s
    )


@pytest.mark.slow
def test_errors_in_dim_frames_are_honest(lab):
    """A hundredth of a photoelectron per pixel: deviations of the steps in units of their standard errors have a mean square of 1."""
    deviations = []
    for seed in range(6):
        capture, _, expected = moving(lab, np.random.default_rng(100 + seed), 0.01)
        found = track(capture)
        deviations.append((found.step_pixels - expected) / found.step_error_pixels)
    assert 0.3 < np.mean(np.square(deviations)) < 4.0  # chi^2 of 12 degrees of freedom, and a systematic error of the same size


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
    np.testing.assert_allclose(content["step_pixels"], expected, atol=SYSTEMATIC_PIXELS)
    with open(tmp_path / "out" / "track.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == FRAMES
    assert float(rows[-1]["row_pixels"]) == pytest.approx((FRAMES - 1) * expected[0], abs=FRAMES * SYSTEMATIC_PIXELS)
    assert {"row_m", "column_m", "row_error_pixels"} <= rows[0].keys()
    assert (tmp_path / "out" / "track.png").stat().st_size > 1000


def test_impossible_arguments_are_refused(lab):
    capture, _, _ = moving(lab, np.random.default_rng(3), 0.3)
    for arguments in ({"source_distance_m": -1.0}, {"interval_s": 0.0}, {"source_distance_m": float("nan")}):
        with pytest.raises(cg.InputError):
            track(capture, **arguments)
    with pytest.raises(cg.InputError, match="three or more"):
        track(cg.Capture(capture.frames[:2]))
    with pytest.raises(cg.InputError, match="capture"):
        track(np.zeros((4, 200, 200)))
