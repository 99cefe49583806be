"""r*r of each of two moving objects from frames that show both."""

import numpy as np
import pytest

import correlograph as cg
from invert.assess.hypotheses import Hypothesis
from invert.tracking.alone import Mixture
from invert.tracking.track import Track
from invert.tracking.tracker import track
from radiometry.autocorrelation import autocorrelate, patch_grid
from radiometry.estimation.autocorrelation_estimator import estimate_autocorrelation
from tests.invert.field.speckle import letter, travelling_frames

PATCH, LAGS = 128, 63
UPRIGHT, WIDE = letter(size=22), letter(size=16).T
"""Two objects: 22 lags high, and 16 lags wide; both lopsided."""


def moving_pair(rng, shape=(500, 620), count=24, light=0.2):
    """Return frames of two objects, the second with 40 % of the light, on paths that part by a grain of 4 pixels in two frames."""
    numbers = np.arange(count)[:, None]
    paths = [numbers * np.array([1.3, -0.4]), numbers * np.array([-0.9, 0.8]) + 2.0 * np.sin(numbers / 5.0)]
    seen = [travelling_frames(one, shape, PATCH, rng, path, 12.0) for one, path in zip((UPRIGHT, WIDE), paths, strict=True)]
    frames = [rng.poisson(light * (0.6 * a + 0.4 * b)).astype(np.float32) for a, b in zip(*seen, strict=True)]
    return cg.Capture(frames), paths


def track_along(path, in_common):
    return Track(path, np.zeros_like(path), 9.0, 1.0, in_common=np.asarray(in_common, float))


def likeness(values, truth, reach=26):
    """Return the correlation of an estimate with r*r of an albedo, up to some lags from zero, which is left out."""
    inside = np.s_[LAGS - reach : LAGS + reach + 1, LAGS - reach : LAGS + reach + 1]
    kept = np.ones((2 * reach + 1, 2 * reach + 1), bool)
    kept[reach, reach] = False
    return np.corrcoef(values[inside][kept], autocorrelate(truth)[inside][kept])[0, 1]


def test_mixing_is_that_of_the_relative_displacement():
    """Two objects that part by (3, -5) pixels per frame, of which neighbours alone share speckle: A is a cosine over the lags."""
    numbers = np.arange(12.0)[:, None]
    tracks = [track_along(numbers * np.array([4.0, 1.0]), [0.4, 0.0]), track_along(numbers * np.array([1.0, 6.0]), [0.1, 0.0])]
    grid = patch_grid((500, 620), (100, 140), 40)
    steps = np.arange(-40, 41)
    turn = 2.0 * np.pi * (3.0 * steps[:, None] / 100 - 5.0 * steps / 140)
    found = Mixture([np.zeros((500, 620))] * 12, tracks).mixing(grid)
    np.testing.assert_allclose(found[..., 0, 1], (0.97 / 0.994) * (135 / 140) / (615 / 620) * np.cos(turn), atol=1e-9)
    np.testing.assert_allclose(found[..., 1, 0], found[..., 0, 1], atol=1e-9)
    np.testing.assert_allclose(found[..., 0, 0], 1.0)


def test_pairs_leave_no_floor(rng):
    """One object, photon noise ten times its speckle: beyond the object, the cross-spectrum of pairs has the mean zero."""
    path = np.arange(16)[:, None] * np.array([1.2, 0.7])
    frames = [
        rng.poisson(0.05 * one).astype(np.float32) for one in travelling_frames(UPRIGHT, (500, 620), PATCH, rng, path, 30.0)
    ]
    grid = patch_grid((500, 620), PATCH, LAGS)
    found = Mixture(frames, [track_along(path, np.exp(-np.arange(1, 9) / 15.0))]).along(0, grid)
    beyond = grid.lag_grid.ring > 50
    assert abs(found[beyond].mean()) < 0.03 * estimate_autocorrelation(frames, grid, "pooled")[0][beyond].mean()
    assert likeness(found, UPRIGHT) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_each_of_two_objects_is_estimated_alone(seed):
    capture, paths = moving_pair(np.random.default_rng(seed))
    found = track(capture)
    tracks = [found, *found.others]
    assert len(tracks) == 2
    assert np.linalg.norm(found.path_pixels[-1] - paths[0][-1]) < 5.0  # the brighter first
    grid = patch_grid((500, 620), PATCH, LAGS)
    joint, _ = estimate_autocorrelation(capture.frames, grid, "pooled")
    joint = joint - joint[grid.lag_grid.ring > 50].mean()
    mixture = Mixture(capture.frames, tracks)
    separate = [mixture.separate(number, grid, joint) for number in (0, 1)]
    for own, truth, other in zip(separate, (UPRIGHT, WIDE), (WIDE, UPRIGHT), strict=True):
        assert 1.0 - likeness(own, truth) < 0.85 * (1.0 - likeness(joint, truth))
        assert likeness(own, truth) > likeness(own, other) + 0.1
    power = [one[grid.lag_grid.ring < 26].sum() for one in separate]
    assert power[1] / power[0] == pytest.approx((0.4 / 0.6) ** 2, rel=0.3)  # squares of the light


@pytest.mark.slow
def test_the_pipeline_reconstructs_the_object_that_was_asked_for():
    capture, paths = moving_pair(np.random.default_rng(5))
    options = {"quality": "fast", "patch": PATCH, "lags": LAGS}
    both = [cg.reconstruct(capture, object_number=number, **options) for number in (1, 2)]
    for result, path, truth, other in zip(both, paths, (UPRIGHT, WIDE), (WIDE, UPRIGHT), strict=True):
        assert any("2 objects move" in note for note in result.notes)
        assert result.hypotheses[Hypothesis.MOVING_OBJECT] > 0.99
        assert set(result.track.warnings) <= set(result.warnings)
        own = cg.aligned_pearson(result.albedo, truth.astype(np.float32))[0]
        assert own > 0.65
        assert own > cg.aligned_pearson(result.albedo, other.astype(np.float32))[0] + 0.1
        assert result.track.step_pixels == pytest.approx(np.diff(path, axis=0).mean(0), abs=0.3)
    with pytest.raises(cg.InputError, match="object_number"):
        cg.reconstruct(capture, object_number=3, **options)
    with pytest.raises(cg.InputError, match="object_number"):
        cg.film(capture, object_number=3)
    film = cg.film(capture, object_number=2, **options)
    np.testing.assert_array_equal(film.albedos[-1], both[1].albedo)
    np.testing.assert_array_equal(film.path.path_pixels, both[1].track.path_pixels)
    assert film.frames_per_image == len(capture.frames)


@pytest.mark.parametrize(
    "options", [{"object_number": 0}, {"object_number": 1.5}, {"object_number": 2, "mean_model": "pooled"}]
)
def test_impossible_objects_are_refused(options):
    with pytest.raises(cg.InputError, match="object_number"):
        cg.reconstruct(np.ones((3, 200, 200)), **options)
