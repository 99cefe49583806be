"""What each start is shown with, and which of a network's candidates are kept."""

import torch

from invert.network.features import PICTURES
from invert.network.inference import AUGMENTATIONS, fuse, observation, reconstruct_by_network
from invert.network.proposals import overview, proposals
from invert.registration import registered
from invert.solvers.base import Candidates
from tests.invert.steps import MIRRORED_STEM, RIGHT, noisy, steps


def padded(*pictures: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.pad(torch.stack(pictures), (0, 64, 0, 64))


def test_every_start_is_shown_with_its_likes():
    """A start's own pictures stand first or third, by the retrieval it came from; the other retrieval's nearest beside it."""
    turned, other = torch.roll(RIGHT.flip((0, 1)), (3, 2), (0, 1)), steps((10, 12, 3, 40), (50, 12, 3, 40))
    found = Candidates(torch.stack((padded(RIGHT, other), padded(other, turned))),
                       torch.tensor([[0.1, 0.2], [0.1, 0.2]]))
    shown = proposals(found, kinds=1)
    assert shown.shape == (4, PICTURES, 64, 64)
    for pictures, object_ in zip(shown, (RIGHT, other, other, RIGHT), strict=True):
        assert float(registered(padded(*pictures), padded(object_)[0])[1].min()) > 0.99
        assert float(pictures.amax((-2, -1)).min()) == float(pictures.max()) == 1.0
    together, agreement = overview(found)
    assert together.shape == (PICTURES, 64, 64)
    assert len(agreement) == 2


def test_starts_are_compared_with_their_own_kind():
    """Where two kinds take turns, what one kind shows never enters the pictures of the other, however alike they are."""
    thick = RIGHT + RIGHT.roll((1, 1), (0, 1))
    assert 0.9 < float(registered(padded(thick), padded(RIGHT)[0])[1]) < 0.95
    images = padded(RIGHT, thick, RIGHT, thick)
    shown = proposals(Candidates(torch.stack((images, images)), torch.tensor([[0.4, 0.1, 0.3, 0.2]] * 2)), kinds=2)
    assert len(shown) == 8
    for pictures, object_ in zip(shown, 4 * [RIGHT] + 4 * [thick], strict=True):
        assert float(registered(padded(*pictures), padded(object_)[0])[1].min()) > 0.999


def test_a_start_that_came_to_nothing_is_shown_as_nothing():
    images = torch.stack((padded(RIGHT, torch.zeros(64, 64)), padded(RIGHT, RIGHT)))
    found = Candidates(images, torch.tensor([[0.1, 1.0], [0.1, 0.1]]))
    assert torch.isfinite(proposals(found, kinds=1)).all()


class Copyist(torch.nn.Module):
    """Draws the first picture that it is shown."""

    def forward(self, seen):
        return seen.classical[:, 0], torch.zeros(len(seen))


def test_looks_are_turned_back():
    seen = observation([noisy()])
    shown = torch.stack((RIGHT, MIRRORED_STEM, RIGHT.mT, RIGHT, MIRRORED_STEM))[:, None].expand(-1, PICTURES, -1, -1)
    albedo, _ = fuse(Copyist(), seen, shown, len(AUGMENTATIONS))
    torch.testing.assert_close(albedo, shown[:, 0])


def test_the_likeliest_candidates_are_kept(monkeypatch):
    """Of many wrong turns and a few right ones the mean is the right one."""
    wrong, right = [MIRRORED_STEM.roll(index, 0) for index in range(20)], [RIGHT.roll(index, 1) for index in range(8)]
    monkeypatch.setattr("invert.network.inference.fuse", lambda *_: (torch.stack(wrong + right), torch.zeros(28)))
    answer = reconstruct_by_network(Copyist(), noisy(), "balanced", 0, "cpu")
    assert float(registered(answer.image[None], padded(RIGHT)[0])[1]) > 0.99
    assert answer.features.agreement > 4.0  # the logit of .98
