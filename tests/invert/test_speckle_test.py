"""Whether the light is speckle of an object: third moment, confidence and warnings, end to end."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import invert
from invert.__main__ import main
from invert.albedo.metrics import aligned_pearson
from radiometry.estimation.third_moment import light_variance
from tests.invert.field.speckle import expected_frame
from tests.light import letter_cells, thrown, wall_texture

PATCH, SHAPE = 257, (1028, 1100)


def letter_light(rng: np.random.Generator) -> np.ndarray:
    """Intensity of mean 1 that an F throws."""
    return thrown(letter_cells("F"), SHAPE, PATCH, rng)[: SHAPE[0], : SHAPE[1]]


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 3])
def test_speckle_of_a_letter_has_the_third_moment_of_the_letter(rng, count):
    frames = np.stack([rng.poisson(0.8 * letter_light(rng)) for _ in range(count)])
    result = invert.reconstruct(frames, quality="fast", patch=PATCH)
    test = result.speckle_test
    assert result.object_found
    assert test is not None
    assert abs(test.third_moment_ratio - 1.0) < 4.0 * test.error + 0.1
    assert test.error < 0.2
    assert test.unexplained < 0.2
    assert result.warnings == ()
    assert result.confidence > 0.8


@pytest.mark.slow
def test_light_that_drifts_by_ten_leaves_the_third_moment(rng):
    """The first eight of sixteen frames have a fifth of the light of the others; before, 0.06 +- 0.01 of it was left."""
    light = 0.5 * 10.0 ** np.linspace(-0.5, 0.5, 16)
    frames = np.stack([rng.poisson(one * letter_light(rng)) for one in light])
    test = invert.reconstruct(frames, quality="fast", patch=PATCH).speckle_test
    assert abs(test.third_moment_ratio - 1.0) < 4.0 * test.error + 0.1


@pytest.mark.slow
def test_one_frame_of_a_textured_wall_is_doubted_and_two_show_nothing(rng, tmp_path, command):
    wall = np.clip(1.0 + 0.2 * wall_texture(SHAPE, rng), 0.05, None)
    frames = [rng.poisson(3.0 * wall).astype(np.uint16) for _ in range(2)]
    np.save(tmp_path / "a.npy", frames[0])
    code, _, err = command(main, tmp_path / "a.npy", "-o", tmp_path / "out", "--quality", "fast", "--patch", PATCH)
    said = json.loads((tmp_path / "out" / "result.json").read_text())
    assert code == 0
    assert said["confidence"] <= 0.5
    if said["object_found"]:
        assert said["warnings"]
        assert err.startswith("warning: ")
    assert not invert.reconstruct(np.stack(frames), quality="fast", patch=PATCH).object_found


@pytest.mark.slow
def test_a_known_blur_is_undone(rng):
    """Two pixels of blur: the estimate, divided by H, is that of the letter without it."""
    light = [letter_light(rng) for _ in range(2)]
    blurred = np.stack([rng.poisson(30.0 * gaussian_filter(one, 2.0, mode="wrap")) for one in light])
    sharp = invert.reconstruct(np.stack([rng.poisson(30.0 * one) for one in light]), quality="fast", patch=PATCH)
    undone = invert.reconstruct(blurred, quality="fast", patch=PATCH, blur_pixels=2.0)
    left_alone = invert.reconstruct(blurred, quality="fast", patch=PATCH, blur_pixels=0.0)
    found = [aligned_pearson(result.albedo, sharp.albedo)[0] for result in (undone, left_alone)]
    assert found[0] > 0.9
    assert found[0] > found[1] + 0.02


def test_the_same_speckle_twice_is_named(rng):
    light = letter_light(rng)
    result = invert.reconstruct(np.stack([rng.poisson(2.0 * light) for _ in range(2)]), quality="fast", patch=PATCH)
    assert any("one speckle pattern" in note and "move the spot" in note for note in result.notes)


@pytest.mark.parametrize("uneven", [False, True])
def test_power_that_differs_between_parts_of_a_frame_is_no_speckle(rng, uneven):
    """Texture whose contrast rises from one side to the other, as in a photograph, against the same of equal contrast."""
    fields = [gaussian_filter(rng.standard_normal(SHAPE), 6.0) for _ in range(2)]
    contrast = np.linspace(0.0, 0.5, SHAPE[1]) if uneven else np.full(SHAPE[1], 0.3)
    frames = np.stack([100.0 * (1.0 + contrast * field / field.std()).clip(0.0) for field in fields])
    test = invert.reconstruct(frames, quality="fast", patch=PATCH).speckle_test
    assert test is not None
    assert (test.part_differences > test.part_threshold) == uneven


def test_the_light_of_parts_varies_as_the_albedo_says(rng):
    """Three dots of 2 x 3 lags throw speckle that hardly changes within an eighth of a frame. Cells of the albedo count as points, which
    makes the variance a little too large."""
    dots = np.zeros((64, 64), np.float32)
    for row, column, bright in ((10, 40, 1.0), (31, 12, 0.6), (50, 44, 0.8)):
        dots[row : row + 2, column : column + 3] = bright
    frames = np.array([expected_frame(dots, (384, 512), 256, rng) for _ in range(60)])
    parts = frames.reshape(60, 4, 96, 4, 128).mean((2, 4))
    assert parts.var() == pytest.approx(light_variance(dots, (256, 256), (96, 128)), rel=0.2)
    uniform = np.ones((64, 64), np.float32)
    assert light_variance(uniform, (256, 256), (96, 128)) < 0.05 * light_variance(dots, (256, 256), (96, 128))


@pytest.mark.parametrize("seed", [0, 7])
def test_speckle_of_a_few_dots_is_speckle(seed):
    """Its power differs between parts of a frame by half, by chance, which raised an alarm for 13 of 14 such objects."""
    rng = np.random.default_rng(seed)
    dots = np.zeros((64, 64), np.float32)
    for _ in range(5):
        row, column = rng.integers(14, 48, 2)
        dots[row : row + 2, column : column + 2] = rng.uniform(0.4, 1.0)
    frames = [rng.poisson(0.3 * expected_frame(dots, (512, 512), 256, rng)).astype(np.float32) for _ in range(10)]
    found = invert.reconstruct(np.stack(frames), quality="fast", patch=256)
    assert found.object_found
    assert found.warnings == ()
