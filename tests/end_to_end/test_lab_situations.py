"""Situations in a lab: unmoved spots, offsets, vignettes, dark frames of every kind, mixed folders. Gains and offsets are random."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import correlograph as cg
from correlograph.files.corrections import pattern_in
from invert.measure.preparation import prepare
from radiometry.estimation.camera_offset import camera_offset, offset_from_speckle
from radiometry.prediction import predict
from sim.frame import Simulation
from sim.plan import Settings

SIDE, FRAMES = 760, 4


@dataclass
class Camera:
    """A camera that converts light to counts."""

    rng: np.random.Generator
    gain: float
    offset: float
    read: float = 1.0
    pattern: float = 0.0

    def __post_init__(self):
        self.static = self.pattern * self.rng.standard_normal((SIDE, SIDE))

    def shoot(self, light) -> np.ndarray:
        electrons = self.rng.poisson(np.broadcast_to(light, (SIDE, SIDE))) + self.read * self.rng.standard_normal((SIDE, SIDE))
        counts = np.round(self.gain * (electrons + self.static) + self.offset)
        return counts.clip(0, 65535).astype(np.float32)


@cache
def simulation_of_lab():
    geometry = cg.load("corner_letter").geometry
    geometry = geometry.with_camera(pixel_pitch_m=1.6 * geometry.camera.pixel_pitch_m, frame_shape=(SIDE, SIDE))
    return Simulation(geometry, Settings(effects=(("shot_noise", False),)))


def light_of(seed):
    """Light of four speckle patterns, 8 photoelectrons per pixel."""
    light = [simulation_of_lab().expected_frame(seed, number).numpy() for number in range(FRAMES)]
    return [8.0 * one / np.mean(light) for one in light]


@pytest.fixture(scope="module")
def lab():
    """`light_of` one seed, with the metadata of the camera and the truth."""
    geometry = simulation_of_lab().geometry
    prediction = predict(geometry)
    metadata = cg.CameraMetadata(geometry.wavelength_m, geometry.camera.pixel_pitch_m, geometry.distance_m)
    truth = cg.Truth(prediction.cells, prediction.pitches_m)
    return light_of(4), metadata, truth


@pytest.fixture
def camera(request):
    rng = np.random.default_rng(sum(map(ord, request.node.name)))
    return Camera(rng, float(rng.uniform(0.5, 4.0)), float(rng.uniform(20.0, 400.0)))


def vignette(rng) -> np.ndarray:
    places = np.linspace(-1.0, 1.0, SIDE)
    return 1.0 - rng.uniform(0.2, 0.4) * ((places[:, None] - 0.1) ** 2 + places[None] ** 2)


def reconstructed(frames, lab, corrections=None):
    result = cg.reconstruct(cg.Capture(frames, lab[1]), corrections=corrections, quality="fast")
    assert result.object_found
    return result, result.compare(lab[2]).pearson


@pytest.mark.slow
def test_an_unmoved_spot_gives_one_frame(lab, camera):
    """Four patterns, because one is one draw: it looks blurred in one capture of seven, more than two of four in one of a hundred."""
    found = [reconstructed([camera.shoot(pattern) for _ in range(FRAMES)], lab) for pattern in lab[0]]
    assert np.mean([pearson for _, pearson in found]) > 0.9
    assert all("one speckle pattern" in " ".join(result.notes) for result, _ in found)
    assert all(result.estimate.record.frames == 1 for result, _ in found)
    warnings = [warning for result, _ in found for warning in result.warnings]
    assert len(warnings) <= 2
    assert all("look blurred" in warning for warning in warnings)


def test_static_texture_is_not_taken_for_an_unmoved_spot(lab, camera):
    """Painted stripes under a lamp, no laser: what the frames share is no speckle, so no object appears."""
    rows = np.arange(SIDE)
    texture = (
        8.0
        + 1.5 * np.sin(rows[:, None] / 9.0) * np.sin(rows[None] / 13.0)
        + 1.5 * np.sin(rows[None] / 6.0 + rows[:, None] / 20.0)
    )
    result = cg.reconstruct(cg.Capture([camera.shoot(texture) for _ in range(FRAMES)], lab[1]), quality="fast")
    assert not any("one speckle pattern" in note for note in result.notes)
    assert not result.object_found or result.confidence <= 0.5


def test_an_offset_under_a_vignette_is_found_and_subtracted(lab, camera):
    shade = vignette(camera.rng)
    frames = [camera.shoot(shade * light) for light in lab[0]]
    result, pearson = reconstructed(frames, lab)
    assert pearson > 0.9
    assert any("offset of about" in note for note in result.notes)
    assert not any("parts of a frame" in warning for warning in result.warnings)
    # Read noise of one electron lowers the estimate by one gain.
    assert camera_offset(frames) == pytest.approx(camera.offset, abs=camera.gain * 1.5 + 0.02 * camera.offset)


def test_the_speckle_of_unevenly_lit_frames_gives_the_offset_that_read_noise_hides(lab):
    """Twelve random cameras with read noise and fixed patterns: offsets within 0.15 of the light, or none."""
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        camera = Camera(rng, float(rng.uniform(0.5, 4.0)), float(rng.uniform(50.0, 400.0)), float(rng.uniform(0.0, 4.0)), 2.0)
        shade, lines = vignette(rng), 3.0 * rng.standard_normal(SIDE)
        offset = offset_from_speckle([camera.shoot(shade * light) + lines for light in lab[0]])
        if offset is not None:
            found.append(offset - camera.offset)
            assert abs(found[-1]) < 0.15 * 8.0 * camera.gain, seed
    assert len(found) >= 6
    assert abs(np.mean(found)) < 1.0


def test_flat_field_frames_without_dark_frames(lab):
    """Four cameras and speckle patterns. In two of sixteen such captures, the noise of the flat field is taken for a blur of less than a
    pixel, which does no harm."""
    blurred = 0
    for seed in range(13, 17):
        rng = np.random.default_rng([seed, 77])
        camera = Camera(rng, float(rng.uniform(0.5, 4.0)), float(rng.uniform(20.0, 400.0)))
        shade, light = vignette(rng), light_of(seed)
        flat = np.mean([camera.shoot(30.0 * shade) for _ in range(20)], axis=0)
        result, pearson = reconstructed([camera.shoot(shade * one) for one in light], lab, cg.Corrections(flat=flat))
        assert pearson > 0.9
        assert any("offset" in note for note in result.notes)
        found = result.estimate.record.blur_found_pixels
        assert found is None or max(found) < 1.0
        blurred += found is not None
    assert blurred <= 1


@pytest.mark.parametrize("count", [1, 12])
def test_the_noise_of_a_dark_frame_is_no_static_pattern(lab, camera, count):
    dark = np.stack([camera.shoot(0.0) for _ in range(count)])
    result, pearson = reconstructed([camera.shoot(light) for light in lab[0]], lab, cg.Corrections(dark=dark))
    assert pearson > 0.9
    assert not result.warnings
    assert result.estimate.record.background.fixed_pattern_lags < 0.1


def test_a_dark_frame_among_the_frames_is_left_out_and_named(lab, camera, tmp_path):
    import tifffile

    for number, light in enumerate((*lab[0], 0.0)):
        tifffile.imwrite(tmp_path / f"shot_{number}.tif", camera.shoot(light).astype(np.uint16))
    result = cg.reconstruct(tmp_path, camera=lab[1], quality="fast")
    assert any("shot_4.tif left out" in note for note in result.notes)
    assert result.estimate.record.frames == FRAMES


def test_a_dark_frame_brighter_than_the_frames_is_refused(lab, camera):
    """Frames from which it has been subtracted already, or one of a longer exposure."""
    frames, dark = [camera.shoot(light) for light in lab[0]], camera.shoot(0.0)
    for dim, own in (([frame - 2.0 * dark for frame in frames], dark), (frames, 40.0 * dark)):
        with pytest.raises(cg.InputError, match="--dark: expected no more light than the frames have"):
            cg.Corrections(dark=own).apply(cg.Capture(dim, lab[1]))


def test_dim_frames_are_not_left_out(lab, camera):
    """Frames of half the light, and frames of hardly any, stay."""
    dim = [camera.shoot((0.3 + 0.7 * number / FRAMES) * light) for number, light in enumerate(lab[0])]
    assert prepare(cg.Capture(dim, lab[1]), cg.Corrections())[1] == []
    for part, notes in ((0.1, 0), (0.02, 1)):  # one of a tenth stays, one of a fiftieth does not
        one_is_dim = [camera.shoot((1.0 if number else part) * light) for number, light in enumerate(lab[0])]
        assert len(prepare(cg.Capture(one_is_dim, lab[1]), cg.Corrections())[1]) == notes
    empty = [camera.shoot(1e-3 * light) for light in lab[0]]
    assert prepare(cg.Capture(empty, lab[1]), cg.Corrections())[1] == []


def test_dark_frames_come_as_folder_stack_file_and_array(lab, camera, tmp_path):
    import tifffile

    darks = [camera.shoot(0.0).astype(np.uint16) for _ in range(3)]
    folder = tmp_path / "darks"
    folder.mkdir()
    for number, dark in enumerate(darks):
        tifffile.imwrite(folder / f"{number}.tif", dark)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack(darks), photometric="minisblack")
    capture = cg.Capture([camera.shoot(lab[0][0])], lab[1])
    found = [
        cg.Corrections(dark=source).apply(capture).frames[0] for source in (folder, tmp_path / "stack.tif", np.stack(darks))
    ]
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    for wrong in (tmp_path / "none", np.zeros((3, 4)), np.zeros(5), np.full((SIDE, SIDE), np.nan)):
        with pytest.raises(cg.InputError, match="--dark"):
            cg.Corrections(dark=wrong).apply(capture)


@pytest.mark.parametrize(("pattern", "noise"), [(0.0, 1.0), (1.0, 1.0), (3.0, 0.5)])
def test_a_dark_frame_is_subtracted_as_far_as_frames_contain_it(pattern, noise):
    """The variance that remains is s^2 v / (s^2 + v) for a pattern of variance s^2 and a noise v; glow and hot pixels go entirely."""
    rng = np.random.default_rng(5)
    shape = (600, 500)
    static = pattern * rng.standard_normal(shape)
    glow = 20.0 * np.linspace(0.0, 1.0, shape[1])[None] ** 2
    hot = np.zeros(shape)
    hot[100, 200] = 400.0
    dark = static + glow + hot + noise * rng.standard_normal(shape)
    frame = static + glow + hot + rng.exponential(2.0, shape)
    left = static + glow + hot - pattern_in(frame.astype(np.float32), dark.astype(np.float32))
    expected = pattern**2 * noise**2 / (pattern**2 + noise**2)
    assert left.var() == pytest.approx(expected, rel=0.1, abs=0.02)
    assert abs(left[100, 200]) < 6.0 * noise + 3.0 * pattern
