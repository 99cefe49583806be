"""Registration undoes shifts and half turns, and nothing else."""

import numpy as np
import pytest
import torch

from invert.identification import identify
from invert.metrics import aligned_pearson
from invert.registration import centred, consensus, on_grid, registered, turned
from invert.spectrum import GRID


def lopsided(random) -> np.ndarray:
    image = np.zeros((64, 64), np.float32)
    image[20:50, 10:14], image[20:26, 10:40] = 0.7, 1.0
    return image + 0.01 * random.random((64, 64)).astype(np.float32)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("shift", [(0, 0), (5, -11), (63, 64)])
def test_shift_and_turn_are_undone(random, turn, shift):
    reference = on_grid(lopsided(random))
    moved = torch.roll(turned(reference) if turn else reference, shift, (0, 1))
    back, correlation = registered(moved[None], reference)
    assert float(correlation[0]) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(back[0], reference, atol=1e-6)


def test_mirrors_are_not_undone(random):
    image = lopsided(random)
    assert aligned_pearson(np.rot90(image, 2), image)[0] > 0.99
    assert aligned_pearson(image[:, ::-1], image)[0] < 0.8
    assert aligned_pearson(image.T, image)[0] < 0.8


def test_centred_keeps_a_wide_lopsided_object(random):
    image = np.zeros((GRID, GRID), np.float32)
    image[3:63, 100:103] = 1.0
    image[58:63, 70:103] = 2.0
    for shift in ((0, 0), (90, 40), (127, 127)):
        window = centred(torch.roll(torch.from_numpy(image), shift, (0, 1)))
        assert float(window.sum()) == pytest.approx(float(image.sum()))
        rows = np.flatnonzero(window.numpy().sum(1))
        assert abs(rows[0] - (63 - rows[-1])) <= 2


def test_consensus_averages_what_agrees(random):
    reference = on_grid(lopsided(random))
    good = [torch.roll(turned(reference) if i % 2 else reference, (i, -2 * i), (0, 1)) for i in range(4)]
    bad = torch.rand(2, GRID, GRID, generator=torch.Generator().manual_seed(0))
    # the one of least residual is wrong: the others outvote it
    mean, agreement = consensus(torch.stack([*bad, *good]), torch.tensor([0.05, 0.6, 0.1, 0.11, 0.12, 0.13]))
    assert float(registered(mean[None], reference)[1][0]) > 0.999
    assert 0.35 < agreement < 0.7


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
