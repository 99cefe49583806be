"""Summary of classical reconstructions for the fusion, and augmentations."""

import torch

from invert.albedo.registration import register_images
from invert.network.features import PICTURES
from invert.network.inference import AUGMENTATIONS, fuse, make_observation
from invert.network.retrieval_summary import summarise_retrievals
from invert.solvers.base import Candidates
from tests.invert.posterior.steps import MIRRORED_STEM, RIGHT, noisy, steps


def pad_images(*pictures: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(torch.stack(pictures), (0, 64, 0, 64))


def test_both_retrievals_are_shown_together():
    """The summary holds the mean of the starts and the start with the lowest residual, registered, and their correlation."""
    turned, other = torch.roll(RIGHT.flip((0, 1)), (3, 2), (0, 1)), steps((20, 20, 3, 20), (40, 20, 3, 20))
    found = Candidates(
        torch.stack((pad_images(RIGHT, turned), pad_images(other, RIGHT))), torch.tensor([[0.2, 0.1], [0.1, 0.2]])
    )
    shown, agreement = summarise_retrievals(found)
    assert shown.shape == (PICTURES, 64, 64)
    assert float(shown.amax((-2, -1)).min()) == float(shown.max()) == 1.0
    for picture, object_ in zip(shown[[0, 1, 3]], (RIGHT, RIGHT, other), strict=True):
        assert float(register_images(pad_images(picture), pad_images(object_)[0])[1]) > 0.99
    assert agreement[0] > 0.99 > agreement[1]


def test_a_start_that_came_to_nothing_is_shown_as_nothing():
    images = torch.stack((pad_images(RIGHT, torch.zeros(64, 64)), pad_images(RIGHT, RIGHT)))
    assert torch.isfinite(summarise_retrievals(Candidates(images, torch.tensor([[0.1, 1.0], [0.1, 0.1]])))[0]).all()


class Copyist(torch.nn.Module):
    """Draws the first picture that it is shown."""

    def forward(self, seen):
        return seen.classical[:, 0], torch.zeros(len(seen))


def test_looks_are_turned_back():
    seen = make_observation([noisy()])
    shown = torch.stack((RIGHT, MIRRORED_STEM, RIGHT.mT, RIGHT, MIRRORED_STEM))[:, None].expand(-1, PICTURES, -1, -1)
    albedo, _ = fuse(Copyist(), seen, shown, len(AUGMENTATIONS))
    torch.testing.assert_close(albedo, shown[:, 0])
