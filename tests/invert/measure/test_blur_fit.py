"""A blur that is not known: found by what it leaves unexplained, none found in sharp frames."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter1d

import invert
import invert.methods
from correlograph.errors import InputError
from invert.__main__ import main
from invert.albedo.metrics import aligned_pearson
from invert.assess.reliability import MAX_UNVERIFIED_CONFIDENCE
from invert.choices import DEFAULT_WEIGHTS, FAST, UNET
from invert.methods import reconstructor
from tests.light import letter_cells, thrown

PATCH, SHAPE = 257, (1028, 1232)
BLUR = {
    "sharp": lambda light: light,
    "defocus": lambda light: gaussian_filter(light, 1.0),
    "motion": lambda light: uniform_filter1d(light, 5, axis=1),
    "wide defocus": lambda light: gaussian_filter(light, 3.0),
}


def frames(character: str, kind: str, photons: float, seed: int) -> np.ndarray:
    """Two frames of a letter, the blur before photons are counted."""
    rng = np.random.default_rng(seed)
    light = [BLUR[kind](thrown(letter_cells(character), SHAPE, PATCH, rng))[: SHAPE[0], : SHAPE[1]] for _ in range(2)]
    return rng.poisson(photons * np.stack(light) / np.mean(light)).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "down", "right"), [("defocus", 1.0, 1.0), ("motion", 0.0, 1.4)])
def test_estimated_blur_is_correct_and_improves_the_reconstruction(kind, down, right):
    """Three letters that blur changes much: at least one blur is found, each found blur is right, and its correction gains
    more than 0.03 in correlation on average. Undetected blurs leave the reconstruction unchanged."""
    gains = []
    for seed, character in enumerate("RK5"):
        blurred = frames(character, kind, 2.0, seed)
        result = invert.reconstruct(blurred, quality="fast", patch=PATCH)
        assert (result.albedo == reconstructor(UNET, FAST).run(result.measurement).albedo).all()
        found = result.estimate.blur_pixels
        assert (found is not None) == any("look blurred" in warning for warning in result.warnings)
        if found is not None:
            assert found == pytest.approx((down, right), abs=0.1)
            untouched = invert.reconstruct(blurred, quality="fast", patch=PATCH, blur_pixels=0.0)
            pearson = [aligned_pearson(one.albedo, letter_cells(character))[0] for one in (result, untouched)]
            gains.append(pearson[0] - pearson[1])
    assert gains
    assert np.mean(gains) > 0.03


@pytest.mark.slow
def test_a_wide_blur_is_found_or_lowers_the_confidence():
    """Letters lose half their likeness to a blur of three pixels, which the network does not notice.

    A blur that is not found lowers the confidence, unless an unexplained part of the signal has lowered it already.
    """
    found = []
    for seed, character in ((0, "R"), (1, "K"), (3, "F")):
        blurred = frames(character, "wide defocus", 2.0, seed)
        result, sharp = (invert.reconstruct(blurred, quality="fast", patch=PATCH, blur_pixels=blur) for blur in (None, 0.0))
        pearson, without = (aligned_pearson(one.albedo, letter_cells(character))[0] for one in (result, sharp))
        found.append(result.estimate.blur_pixels is not None)
        if found[-1]:
            assert result.estimate.blur_pixels == pytest.approx((3.0, 3.0), rel=0.1)
            assert pearson > without + 0.1
        else:
            assert (
                result.confidence < sharp.confidence - 0.1 or result.confidence <= sharp.confidence <= MAX_UNVERIFIED_CONFIDENCE
            )
    assert any(found)


@pytest.mark.slow
def test_the_search_uses_the_weights_of_the_user(monkeypatch, tmp_path):
    used, weights = set(), tmp_path / "own.safetensors"
    weights.write_bytes(DEFAULT_WEIGHTS.read_bytes())
    load = invert.methods.load_network
    monkeypatch.setattr("invert.methods.load_network", lambda file, device: used.add(file) or load(file, device))
    invert.reconstruct(frames("R", "defocus", 2.0, 0), quality="fast", patch=PATCH, weights=weights)
    assert used == {weights}


@pytest.mark.slow
@pytest.mark.parametrize("photons", [0.2, 20.0])
def test_sharp_frames_are_not_taken_for_blurred(photons):
    for seed, character in enumerate("R5L"):
        result = invert.reconstruct(frames(character, "sharp", photons, seed), quality="fast", patch=PATCH)
        assert result.estimate.blur_pixels is None
        assert result.object_found
        assert (result.albedo == reconstructor(UNET, FAST).run(result.measurement).albedo).all()


@pytest.mark.slow
def test_blur_pixels_zero_disables_blur_estimation(tmp_path, command):
    files = [tmp_path / "a.npy", tmp_path / "b.npy"]
    for file, frame in zip(files, frames("K", "defocus", 2.0, 1), strict=True):
        np.save(file, frame)
    for given in ((), ("--blur-pixels", "0")):
        options = "-o", tmp_path / "out", "--quality", "fast", "--patch", PATCH, *given
        assert command(main, *files, *options)[0] == 0
        summary = json.loads((tmp_path / "out" / "result.json").read_text())
        assert ("blur_found_pixels" in summary) is not bool(given)
    with pytest.raises(InputError, match="blur_pixels"):
        invert.reconstruct(frames("R", "sharp", 2.0, 0), blur_pixels=-1.0)
