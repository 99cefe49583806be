"""Detection of dim objects, and the light that a result without an object asks for."""

import re

import numpy as np

import correlograph as cg
from tests.light import letter_cells, thrown

PATCH, SHAPE = 200, (900, 1010)


def result_at(photons: float, count: int = 2) -> cg.Result:
    """Reconstruct `count` frames of a P with a mean number of photons per pixel."""
    rng = np.random.default_rng(11)
    light = [thrown(letter_cells("P"), SHAPE, PATCH, rng)[: SHAPE[0], : SHAPE[1]] for _ in range(count)]
    return cg.reconstruct(rng.poisson(photons * np.stack(light)), patch=PATCH, quality="fast", method="classical")


def test_significance_is_proportional_to_light():
    dim, bright = (result_at(photons).measurement.detection for photons in (0.004, 0.008))
    assert bright / dim > 1.6
    assert bright / dim < 2.5


def test_a_result_without_an_object_asks_for_light_that_does_not_suffice_and_not_for_too_much():
    photons = 0.0008
    dim = result_at(photons)
    assert not dim.object_found
    (note,) = (text for text in dim.notes if text.startswith("no signal"))
    times, frames = map(float, re.findall(r"more than (.*?) times the light, or (.*?) times", note)[0])
    assert frames == np.round(times**2, 1) or abs(frames - times**2) < 0.1 * frames
    assert not result_at(0.9 * times * photons).measurement.detectable
    assert result_at(6.0 * times * photons).measurement.detectable
