"""Which of a network's drawings is kept: likelihood of an estimate under each, and what each start is shown with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize_scalar

from invert.features import PICTURES
from invert.learned import POSES, draw, look, observation
from invert.projections import Candidates
from invert.proposals import log_likelihoods, overview, proposals
from invert.registration import registered
from invert.spectrum import read_measurement
from invert.training_data import at_noise
from radiometry.noise_level import RING
from radiometry.noise_model import log_likelihood, window_smoothed


def steps(*blocks: tuple[int, int, int, int]) -> torch.Tensor:
    """Blocks (row, column, height, width), each brighter than the last; (64, 64)."""
    image = torch.zeros(64, 64)
    for number, (row, column, height, width) in enumerate(blocks, 2):
        image[row : row + height, column : column + width] = number / (len(blocks) + 1)
    return image


RIGHT = steps((14, 20, 30, 5), (14, 25, 5, 17), (27, 25, 5, 11))
MIRRORED_STEM = steps((14, 37, 30, 5), (14, 20, 5, 17), (27, 20, 5, 11))


@pytest.fixture(scope="module")
def measurement():
    estimate = at_noise(RIGHT[None], 0.3, 64.0, torch.Generator().manual_seed(2)).seen.estimate[0]
    return read_measurement(estimate.numpy())


def test_likelihoods_are_those_of_the_noise_model(measurement):
    """Differences between drawings are those of `log_likelihood` at each one's likeliest brightness."""
    albedos = torch.stack((RIGHT, MIRRORED_STEM, RIGHT + 0.02 * MIRRORED_STEM))
    near = torch.from_numpy(RING <= 1)  # the same for all
    noise, estimate = measurement.noise, torch.from_numpy(measurement.estimate).double().masked_fill(near, 1.0)

    def at_best(albedo: torch.Tensor) -> float:
        def cost(log_brightness: float) -> float:
            expected = noise.floor + float(np.exp(log_brightness)) * window_smoothed(albedo.double())
            return -float(log_likelihood(estimate, expected.masked_fill(near, 1.0), noise.dof))

        return -minimize_scalar(cost, bounds=(-15.0, 5.0), method="bounded", options={"xatol": 1e-6}).fun

    found, wanted = log_likelihoods(albedos, measurement), torch.tensor([at_best(one) for one in albedos])
    torch.testing.assert_close(found - found[0], wanted - wanted[0], rtol=1e-3, atol=0.05, check_dtype=False)
    assert float(found[0] - found[1]) > 20.0


@pytest.mark.parametrize("unit", [1e-30, 1.0, 1e30])
def test_likelihood_knows_no_shift_turn_brightness_or_unit(measurement, unit):
    same = torch.stack((RIGHT, 7.0 * RIGHT, torch.roll(RIGHT, (5, -3), (0, 1)), RIGHT.flip((0, 1))))
    noise = replace(measurement.noise, floor=unit * measurement.noise.floor)
    scaled = replace(measurement, estimate=np.float32(unit) * measurement.estimate, noise=noise)
    found = log_likelihoods(same, scaled)
    assert float((found - log_likelihoods(RIGHT[None], measurement)).abs().max()) < 0.02


def test_likelihood_of_an_empty_drawing_and_without_noise(measurement):
    """Nothing explains an object worse than any object does; without noise the truth is the likeliest."""
    blank = log_likelihoods(torch.stack((torch.zeros(64, 64), MIRRORED_STEM)), measurement)
    assert torch.isfinite(blank).all()
    assert blank[1] > blank[0]
    silent = read_measurement(window_smoothed(RIGHT).numpy())
    found = log_likelihoods(torch.stack((MIRRORED_STEM, RIGHT)), silent)
    assert torch.isfinite(found).all()
    assert found[1] > found[0]


def padded(*pictures: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(torch.stack(pictures), (0, 64, 0, 64))


def test_every_start_is_shown_with_its_likes():
    """A start's own pictures stand first or third, by the retrieval it came from; the other retrieval's nearest beside it."""
    turned, other = torch.roll(RIGHT.flip((0, 1)), (3, 2), (0, 1)), steps((10, 12, 3, 40), (50, 12, 3, 40))
    found = Candidates(torch.stack((padded(RIGHT, other), padded(other, turned))),
                       torch.tensor([[0.1, 0.2], [0.1, 0.2]]))
    shown = proposals(found)
    assert shown.shape == (4, PICTURES, 64, 64)
    for pictures, object_ in zip(shown, (RIGHT, other, other, RIGHT), strict=True):
        assert float(registered(padded(*pictures), padded(object_)[0])[1].min()) > 0.99
        assert float(pictures.amax((-2, -1)).min()) == float(pictures.max()) == 1.0
    together, agreement = overview(found)
    assert together.shape == (PICTURES, 64, 64)
    assert len(agreement) == 2


def test_a_start_that_came_to_nothing_is_shown_as_nothing():
    images = torch.stack((padded(RIGHT, torch.zeros(64, 64)), padded(RIGHT, RIGHT)))
    found = Candidates(images, torch.tensor([[0.1, 1.0], [0.1, 0.1]]))
    assert torch.isfinite(proposals(found)).all()


class Copyist(torch.nn.Module):
    """Draws the first picture that it is shown."""

    def forward(self, seen):
        return seen.classical[:, 0], torch.zeros(len(seen))


def test_looks_are_turned_back(measurement):
    seen = observation([measurement])
    shown = torch.stack((RIGHT, MIRRORED_STEM, RIGHT.mT, RIGHT, MIRRORED_STEM))[:, None].expand(-1, PICTURES, -1, -1)
    albedo, _ = look(Copyist(), seen, shown, len(POSES))
    torch.testing.assert_close(albedo, shown[:, 0])


def test_the_likeliest_drawings_are_kept(measurement, monkeypatch):
    """Of many wrong turns and a few right ones the mean is the right one."""
    wrong, right = [MIRRORED_STEM.roll(index, 0) for index in range(20)], [RIGHT.roll(index, 1) for index in range(8)]
    monkeypatch.setattr("invert.learned.look", lambda *_: (torch.stack(wrong + right), torch.zeros(28)))
    drawing = draw(Copyist(), measurement, "balanced", 0, "cpu")
    assert float(registered(drawing.image[None], padded(RIGHT)[0])[1]) > 0.99
    assert drawing.signs[1] > 0.99
