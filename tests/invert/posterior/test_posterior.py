"""Statistics of samples: registration, deviation, clusters, sizes."""

import numpy as np
import pytest
import torch

from correlograph.errors import InputError
from invert.albedo.posterior import Samples, SizeStatistics, measure_size, register_samples
from tests.invert.posterior.steps import MIRRORED_STEM, RIGHT


def make_samples(*albedos: torch.Tensor) -> Samples:
    return register_samples(torch.stack(albedos), RIGHT)


def test_samples_are_laid_over_the_reconstruction():
    """Shifted, turned and half as bright ones lie where it does."""
    drawn = make_samples(RIGHT, 0.5 * RIGHT.roll((3, -5), (0, 1)), RIGHT.flip((0, 1)).roll((-2, 4), (0, 1)))
    for one in drawn.samples:
        np.testing.assert_allclose(one, RIGHT, atol=1e-6)
    np.testing.assert_allclose(drawn.mean, RIGHT, atol=1e-6)
    assert not drawn.deviation.any()


def test_samples_follow_a_reconstruction_that_is_turned():
    turned = RIGHT.flip((0, 1)).roll((4, -3), (0, 1)).numpy()
    for one in make_samples(RIGHT, RIGHT.roll((3, -5), (0, 1))).register_to(turned).samples:
        np.testing.assert_allclose(one, turned, atol=1e-6)


def test_mean_spread_and_probability_of_light():
    wider = RIGHT.clone()
    wider[5, 10] = 1.0
    drawn = Samples(torch.stack((RIGHT, RIGHT, RIGHT, wider)).numpy())
    assert drawn.mean[5, 10] == pytest.approx(0.25)
    assert drawn.bright[5, 10] == pytest.approx(0.25)
    assert drawn.deviation[5, 10] == pytest.approx((0.25 * 0.75) ** 0.5)


def test_different_objects_are_different_answers():
    """Noise creates no new cluster; another position of the stem does, and the more probable cluster comes first."""
    rng = torch.Generator().manual_seed(0)

    def noisy(image: torch.Tensor) -> torch.Tensor:
        return (image + 0.1 * torch.randn(image.shape, generator=rng)).clamp(0.0, 1.0)

    assert len(make_samples(*(noisy(RIGHT) for _ in range(8))).clusters) == 1
    both = make_samples(*(noisy(RIGHT) for _ in range(6)), *(noisy(MIRRORED_STEM) for _ in range(2))).clusters
    assert [one.probability for one in both] == [0.75, 0.25]
    assert [one.members for one in both] == [(0, 1, 2, 3, 4, 5), (6, 7)]


def test_sizes_and_their_intervals():
    """Rectangles of known width and height; the interval of equal tails is numpy's."""
    samples = np.zeros((21, 64, 64), np.float32)
    for number, one in enumerate(samples):
        one[10:17, 20 : 30 + number] = 0.9
        one[40, 40] = 0.3  # too dark to count
    assert [measure_size(samples[3], size) for size in ("width", "height", "area")] == [13.0, 7.0, 91.0]
    assert Samples(samples).interval("width", 0.5) == (15.0, 25.0)
    assert Samples(samples).interval("height", 0.95) == (7.0, 7.0)
    assert measure_size(np.zeros((64, 64)), "width") == 0.0


def test_an_unknown_size_or_probability_is_refused():
    said = make_samples(RIGHT, RIGHT)
    with pytest.raises(InputError, match="size: expected one of width, height, area"):
        said.interval("depth", 0.8)
    with pytest.raises(InputError, match="probability: expected a number from 0 to 1"):
        said.interval("width", 80.0)


def test_calibrated_intervals_hold_the_truth_as_often_as_they_say(rng):
    """Samples that are too much alike and too wide by a tenth: sizes of truths fall into their intervals all the same."""

    def case() -> tuple[Samples, float]:
        wide = int(rng.integers(10, 30))
        seen = wide * 1.1 + rng.normal(0.0, 2.0)
        samples = np.zeros((12, 64, 64), np.float32)
        for one in samples:
            one[30:34, 5 : 5 + round(seen + rng.normal(0.0, 0.5))] = 1.0
        return Samples(samples), float(wide)

    def errors_of(cases) -> list[float]:
        return [SizeStatistics.of(said.samples, "width").error(truth) for said, truth in cases]

    known = {"width": np.quantile(errors_of([case() for _ in range(400)]), np.linspace(0.0, 1.0, 41)).tolist()}
    later = [case() for _ in range(400)]
    for probability in (0.5, 0.8, 0.95):
        held, bare = (
            np.mean(
                [
                    low <= truth <= high
                    for said, truth in later
                    for low, high in [Samples(said.samples, errors).interval("width", probability)]
                ]
            )
            for errors in (known, None)
        )
        assert held == pytest.approx(probability, abs=0.08)
        assert bare < probability - 0.2
