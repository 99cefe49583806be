"""Speckle that travels is distinguished from a camera that moves over static light."""

import numpy as np
import pytest

import correlograph as cg
from invert.tracking.travel import find_travel
from tests.invert.field.speckle import expected_frame, letter, travelling_fields

SHAPE, PATCH, FRAMES = (330, 390), 128, 6


def travelling(rng, light, step):
    """Return frames of one speckle pattern that moves by `step` pixels from frame to frame."""
    reach = [abs(one) * FRAMES for one in step]
    wide = light * expected_frame(letter(), (SHAPE[0] + reach[0], SHAPE[1] + reach[1]), PATCH, rng)
    starts = [[(FRAMES - n if one > 0 else n) * abs(one) for one in step] for n in range(FRAMES)]
    return [rng.poisson(wide[a : a + SHAPE[0], b : b + SHAPE[1]]).astype(np.float32) for a, b in starts]


def shaking(rng, light, step, texture):
    """Return frames of independent speckle over a static texture, which the camera's shift moves."""
    wide = expected_frame(letter(), (SHAPE[0] + 60, SHAPE[1] + 60), 64, rng)
    frames = []
    for n in range(FRAMES):
        a, b = (30 - one * (n % 2) for one in step)
        static = texture * wide[a : a + SHAPE[0], b : b + SHAPE[1]]
        frames.append(rng.poisson(light * (expected_frame(letter(), SHAPE, PATCH, rng) + static)).astype(np.float32))
    return frames


@pytest.mark.parametrize(("light", "step"), [(0.1, (3, -5)), (2.0, (-1, 4)), (20.0, (2, 2))])
def test_travelling_speckle_is_found_and_pooled(rng, light, step):
    capture = cg.Capture(travelling(rng, light, step))
    assert find_travel(capture).steps_pixels[0] == pytest.approx(step, abs=0.1)
    result = cg.reconstruct(capture, quality="fast", patch=PATCH, blur_pixels=0.0)
    said = " ".join((*result.notes, *result.warnings))
    assert "the speckle travels by about" in said
    assert "camera" not in said
    assert "static pattern" not in said
    assert result.object_found
    assert result.compare(letter()).pearson > 0.8


@pytest.mark.parametrize(("light", "texture"), [(2.0, 1.0), (20.0, 0.5)])
def test_a_shaking_camera_is_still_named(rng, light, texture):
    capture = cg.Capture(shaking(rng, light, (4, -3), texture))
    assert find_travel(capture) is None
    result = cg.reconstruct(capture, quality="fast", patch=PATCH, blur_pixels=0.0)
    assert any("camera shifted" in warning for warning in result.warnings)


@pytest.mark.parametrize("seed", range(6))
def test_independent_speckle_does_not_travel(seed):
    rng = np.random.default_rng(seed)
    frames = [rng.poisson(2.0 * expected_frame(letter(), SHAPE, PATCH, rng)).astype(np.float32) for _ in range(FRAMES)]
    assert find_travel(cg.Capture(frames)) is None


PARTS = np.roll(letter(size=22), (-8, -14), (0, 1)), np.roll(letter(size=16).T, (10, 14), (0, 1))


def test_two_parts_of_one_object_travel_together(rng):
    """Their interference is part of its pattern, and travels with it."""
    numbers, step = np.arange(12.0)[:, None], np.array([1.6, -0.4])
    fields = travelling_fields(sum(PARTS), SHAPE, PATCH, rng, numbers * step, 1e6)
    found = find_travel(cg.Capture([rng.poisson(0.4 * np.abs(one) ** 2).astype(np.float32) for one in fields]))
    assert found.steps_pixels == pytest.approx(step[None], abs=0.02)
    assert found.share == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_objects_beside_each_other_travel(seed):
    """Half of the power of two objects of equal light is their interference, whose phase is new in every frame."""
    rng, numbers = np.random.default_rng(seed), np.arange(24.0)[:, None]
    steps = np.array([[1.6, -0.4], [-0.9, 1.2]])
    fields = [
        travelling_fields(one, (420, 500), PATCH, rng, numbers * step, 60.0) for one, step in zip(PARTS, steps, strict=True)
    ]
    turns = np.exp(2j * np.pi * rng.random(24))
    frames = [0.2 * np.abs(a + turn * b) ** 2 for a, b, turn in zip(*fields, turns, strict=True)]
    found = find_travel(cg.Capture([rng.poisson(one).astype(np.float32) for one in frames]))
    assert len(found.steps_pixels) == 2
    for step in steps:
        assert np.linalg.norm(found.steps_pixels - step, axis=1).min() < 0.1
    assert 0.8 < found.share < 1.2
