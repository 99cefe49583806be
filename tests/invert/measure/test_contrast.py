"""Contrast of speckle, and the blur that it leaves room for."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import correlograph as cg
from invert.blur_fit import largest_blurs, search_blur
from invert.measure.estimate import estimate_from_frames
from invert.methods import empty_reconstruction
from invert.request import Request
from tests.light import letter_cells, thrown

SHAPE, PATCH = (500, 620), 257


def contrasts(frames, **known):
    request = Request(patch=PATCH, **known)
    return [estimate_from_frames(cg.Capture([one.astype(np.float32)]), request).record.contrast for one in frames]


def light(character, rng, count=8):
    return [thrown(letter_cells(character), SHAPE, PATCH, rng) for _ in range(count)]


@pytest.mark.parametrize("photons", [0.3, 30.0])
def test_speckle_of_one_polarisation_has_contrast_one(rng, photons):
    found = contrasts(rng.poisson(photons * one) for one in light("R", rng))
    away = np.array([(one.square - 1.0) / one.error for one in found])
    assert np.abs(away.mean()) < 3.0 / len(away) ** 0.5
    assert 0.3 < (away**2).mean() < 2.6  # chi^2 of eight, 1 in 200 on either side


def test_ambient_light_and_a_second_polarisation_lower_it(rng):
    both = list(zip(light("F", rng), light("F", rng), strict=True))
    found = contrasts(rng.poisson(5.0 * (one + other)) for one, other in both)
    assert np.mean([one.square for one in found]) == pytest.approx(0.5, abs=0.05)
    found = contrasts(rng.poisson(5.0 * (one + 0.5)) for one, _ in both)
    assert np.mean([one.square for one in found]) == pytest.approx(1.0 / 1.5**2, abs=0.05)


def test_contrast_is_that_of_the_frames_whatever_their_known_blur(rng):
    blurred = [rng.poisson(20.0 * gaussian_filter(one, 1.5)) for one in light("R", rng)]
    with_blur, without = (np.mean([one.square for one in contrasts(blurred, blur_pixels=blur)]) for blur in (1.5, 0.0))
    assert with_blur == without < 0.85


def test_sharp_frames_leave_no_room_for_blur(rng):
    cells = np.zeros((64, 64))
    cells[20:40, 12:50] = np.hanning(20)[:, None] * np.hanning(38)
    for shown in (letter_cells("t"), cells):
        capture = cg.Capture([rng.poisson(8.0 * thrown(shown, SHAPE, PATCH, rng)).astype(np.float32) for _ in range(2)])
        assert largest_blurs(estimate_from_frames(capture, Request(patch=PATCH))) == {}


def blurred_estimate(rng, blur, ambient=0.0):
    blurred = [gaussian_filter(one, blur) + ambient for one in light("R", rng)]
    return estimate_from_frames(
        cg.Capture([rng.poisson(20.0 * one).astype(np.float32) for one in blurred]), Request(patch=PATCH)
    )


@pytest.mark.parametrize("blur", [(1.3, 1.3), (0.0, 1.6), (1.1, 0.0), (3.0, 3.0)])
def test_the_largest_blur_is_that_of_the_frames(rng, blur):
    found = largest_blurs(blurred_estimate(rng, blur)).values()
    nearest = min(found, key=lambda one: np.hypot(one[0] - blur[0], one[1] - blur[1]))
    assert nearest == pytest.approx(blur, rel=0.1, abs=0.15)


@pytest.mark.parametrize("blur", [0.0, 1.5, 3.0])
def test_other_light_leaves_room_for_blur_until_a_lag_exceeds_zero_lag(rng, blur):
    """r*r of R falls to a third at a lag of seven along rows or columns, and so does H of a blur of six pixels."""
    largest = largest_blurs(blurred_estimate(rng, blur, ambient=8.0))[1.0, 1.0]
    assert blur < largest[0] < np.hypot(blur, 6.0)


def test_other_light_is_told_from_blur_if_no_blur_explains_it(rng):
    def needs_other_light(ambient):
        found = search_blur(blurred_estimate(rng, 1.3, ambient), lambda measurement, number: empty_reconstruction(64))
        return found.estimate.record.needs_other_light

    assert [needs_other_light(ambient) for ambient in (0.0, 8.0)] == [False, True]
