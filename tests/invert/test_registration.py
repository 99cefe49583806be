"""Registration undoes shifts and rotations by 180 degrees, and nothing else."""

import numpy as np
import pytest
import torch

from correlograph.lags import LAGS, lag_grid
from invert.albedo.metrics import aligned_pearson
from invert.albedo.registration import (
    consensus,
    crop_centred,
    on_grid,
    phase_retrieval_transfer,
    register_groups,
    register_images,
    rotate_180,
)
from invert.evaluation.identification import identify

GRID = lag_grid(LAGS).padded_side


def asymmetric_image(rng) -> np.ndarray:
    image = np.zeros((64, 64), np.float32)
    image[20:50, 10:14], image[20:26, 10:40] = 0.7, 1.0
    return image + 0.01 * rng.random((64, 64)).astype(np.float32)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("shift", [(0, 0), (5, -11), (63, 64)])
def test_shift_and_turn_are_undone(rng, turn, shift):
    reference = on_grid(asymmetric_image(rng))
    moved = torch.roll(rotate_180(reference) if turn else reference, shift, (0, 1))
    back, correlation = register_images(moved[None], reference)
    assert float(correlation[0]) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(back[0], reference, atol=1e-6)


def test_each_image_is_laid_over_its_own_reference(rng):
    references = torch.stack([torch.from_numpy(asymmetric_image(rng)), torch.from_numpy(asymmetric_image(rng)).mT])
    moved = torch.stack([torch.roll(references[0].flip((0, 1)), (3, 4), (0, 1)), torch.roll(references[1], (-5, 2), (0, 1))])
    back = register_groups(torch.stack((moved, 0.5 * moved.square()), 1), references)
    for (one, other), reference in zip(back, references, strict=True):
        assert np.corrcoef(one.ravel(), reference.ravel())[0, 1] > 0.99
        torch.testing.assert_close(other, 0.5 * one.square())  # the second goes where the first goes
    assert not register_groups(torch.zeros(1, 2, 64, 64), references[:1]).any()


def test_mirrors_are_not_undone(rng):
    image = asymmetric_image(rng)
    assert aligned_pearson(np.rot90(image, 2), image)[0] > 0.99
    assert aligned_pearson(image[:, ::-1], image)[0] < 0.8
    assert aligned_pearson(image.T, image)[0] < 0.8


def test_centred_keeps_a_wide_lopsided_object(rng):
    image = np.zeros((GRID, GRID), np.float32)
    image[3:63, 100:103] = 1.0
    image[58:63, 70:103] = 2.0
    for shift in ((0, 0), (90, 40), (127, 127)):
        window = crop_centred(torch.roll(torch.from_numpy(image), shift, (0, 1)))
        assert float(window.sum()) == pytest.approx(float(image.sum()))
        rows = np.flatnonzero(window.numpy().sum(1))
        assert abs(rows[0] - (63 - rows[-1])) <= 2
        pair = crop_centred(torch.roll(torch.stack((torch.from_numpy(image), torch.zeros(GRID, GRID))), shift, (-2, -1)))
        torch.testing.assert_close(pair[0], window)


def test_consensus_averages_what_agrees(rng):
    reference = on_grid(asymmetric_image(rng))
    good = [torch.roll(rotate_180(reference) if i % 2 else reference, (i, -2 * i), (0, 1)) for i in range(4)]
    bad = torch.rand(2, GRID, GRID, generator=torch.Generator().manual_seed(0))
    # the one of least residual is wrong: the others outvote it
    together = consensus(torch.stack([*bad, *good]), torch.tensor([0.05, 0.6, 0.1, 0.11, 0.12, 0.13]))
    assert float(register_images(together.image[None], reference)[1][0]) > 0.999
    assert 0.35 < together.agreement < 0.7


def test_transfer_is_one_where_phases_agree_and_falls_where_they_do_not(rng):
    reference = on_grid(asymmetric_image(rng))
    assert min(phase_retrieval_transfer(torch.stack([reference] * 4))) > 0.999
    n = 64
    noise = torch.randn(n, GRID, GRID, generator=torch.Generator().manual_seed(2))
    # mean of n unit phasors: Rayleigh of mean sqrt(pi / (4 n)); weighted by |F|, also Rayleigh, about the same
    assert np.mean(phase_retrieval_transfer(noise)[4:]) == pytest.approx(1.0 / np.sqrt(n), rel=0.15)
    sharp, blurred_noise = torch.stack([reference] * n), torch.fft.irfft2(torch.fft.rfft2(noise) * high_pass(), s=(GRID, GRID))
    transfer = phase_retrieval_transfer(sharp + 3.0 * blurred_noise)
    assert transfer[2] > 0.95
    assert transfer[30] < 0.5


def high_pass() -> torch.Tensor:
    row, column = torch.fft.fftfreq(GRID)[:, None], torch.fft.rfftfreq(GRID)
    return (torch.hypot(row, column) > 0.25).float()


def test_a_glyph_is_identified_turned_and_stretched():
    from matplotlib import get_data_path
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.truetype(f"{get_data_path()}/fonts/ttf/DejaVuSans-Bold.ttf", 40)
    canvas = Image.new("L", (64, 64))
    ImageDraw.Draw(canvas).text((32, 32), "R", fill=255, font=font, anchor="mm")
    drawn = np.asarray(canvas.rotate(15).resize((64, 44)), np.float32)
    image = np.zeros((64, 64), np.float32)
    image[10:54] = drawn
    names = "RPBFAK4"
    assert identify(image, characters=names)[0][0] == "R"
    assert identify(image[:, ::-1], characters=names, mirrored=True)[0][0] == "R"
