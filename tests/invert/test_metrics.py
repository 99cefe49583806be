"""Scores: right where the answer is known, and deceived by nothing that they are there to catch."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from correlograph.errors import InputError
from invert.albedo.metrics import Scores, agreement, aligned_pearson, bootstrap_error, register_subpixel, score
from invert.output.truth import Truth
from radiometry.autocorrelation import autocorrelate, smooth_by_window


@pytest.fixture
def truth() -> np.ndarray:
    """A lopsided letter of two albedos."""
    image = np.zeros((64, 64))
    image[18:48, 20:25], image[18:23, 20:44], image[31:35, 20:36] = 1.0, 1.0, 0.7
    return image


def test_a_moved_turned_and_scaled_copy_is_perfect(truth):
    found = score(7.5 * np.roll(np.rot90(truth, 2), (3, -5), (0, 1)), truth)
    assert found == Scores(pytest.approx(1.0), pytest.approx(1.0), found.psnr_db, 1.0, 1.0, True)
    assert found.psnr_db > 120.0


def test_a_mirrored_copy_is_not(truth):
    found = score(truth[:, ::-1], truth)
    assert found.pearson < 0.8
    assert found.iou < 0.7
    assert not found.success


def test_nothing_scores_nothing(truth):
    found = score(np.zeros((64, 64)), truth)
    assert (found.pearson, found.iou, found.edge_f1, found.success) == (0.0, 0.0, 0.0, False)
    with pytest.raises(ValueError, match="contrast"):
        score(truth, np.ones((64, 64)))


def test_psnr_after_gain_is_that_of_the_noise(truth, rng):
    noise = rng.standard_normal(truth.shape)
    noise -= truth * (noise * truth).sum() / (truth * truth).sum()  # orthogonal, so that the best gain is 1
    found = score(3.0 * (truth + 0.05 * noise), truth)
    # least squares shrinks the noisy image a little: error e E / (e + E) instead of e
    error, energy = (0.05**2 * noise**2).sum(), (truth**2).sum()
    assert found.psnr_db == pytest.approx(-10 * np.log10(error * energy / (error + energy) / truth.size), abs=0.02)


def test_fractions_of_a_pixel_are_registered(truth):
    smooth = ndimage.gaussian_filter(truth, 1.2)
    moved = ndimage.shift(smooth, (2.4, -3.3), order=5)
    whole, _ = aligned_pearson(moved, smooth)
    fine, back = register_subpixel(moved, smooth)
    assert fine > 0.999 > whole
    assert np.abs(back - smooth).max() < 0.03


def test_overlap_and_outlines_of_known_shapes(truth):
    image = truth.copy()
    image[31:35, 25:36], image[44:48, 30:41] = 0.0, 0.6  # 44 of 289 pixels moved
    assert score(image, truth).iou == pytest.approx(245 / 333)
    thin = np.zeros((64, 64))
    thin[12, 5:60], thin[12:50, 30] = 1.0, 1.0
    beside = np.roll(thin, 1, 0) + 1e-6
    beside[40:, :] = thin[40:, :]
    assert score(thin, thin).edge_f1 == 1.0
    assert score(beside, thin).edge_f1 == pytest.approx(1.0, abs=0.03)


def test_agreement_is_deceived_and_pearson_is_not(truth):
    """A bright point beside a faint copy has nearly the object's autocorrelation: the reason why agreement is no evidence."""
    deceiver = 0.05 * truth
    deceiver[2, 60] = 3.0 * truth.sum() * 0.05
    estimate = smooth_by_window(autocorrelate(truth)) + 2.0
    assert agreement(truth, estimate, 2.0, 40) > 0.999
    assert agreement(np.rot90(truth), estimate, 2.0, 40) < 0.9
    assert score(deceiver, truth).pearson < 0.3


def test_bootstrap_error_is_that_of_a_mean(rng):
    values = rng.standard_normal(400)
    assert bootstrap_error(values) == pytest.approx(values.std() / 20.0, rel=0.1)
    assert bootstrap_error(np.ones(5)) == 0.0


def test_a_truth_of_known_pitch_need_not_be_square(tmp_path):
    drawn = np.zeros((4, 7), np.float32)
    drawn[1, 2:5] = 1.0
    Image.fromarray((255 * drawn).astype(np.uint8)).save(tmp_path / "drawn.png")
    for truth in (Truth(drawn, (2.0, 2.0)), Truth.read(str(tmp_path / "drawn.png"), 2.0)):
        assert truth.albedo.shape == (7, 7)
        assert truth.albedo[2, 2:5].all()
        assert np.count_nonzero(truth.albedo) == 3
        assert truth.pitches_m == (2.0, 2.0)
    with pytest.raises(InputError, match="truth-pitch-m"):
        Truth(drawn)
    for pitches in ((1.0, -1.0), (1.0,), "ab", True):
        with pytest.raises(InputError, match="pitches_m"):
            Truth(drawn, pitches)
    with pytest.raises(InputError, match="two images"):
        score(np.zeros((0, 0)), np.zeros((0, 0)))
