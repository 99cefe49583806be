"""Pieces of photographs as grey targets."""

import numpy as np
from PIL import Image

from data_gen.edges import find_photographs
from data_gen.pieces import piece
from data_gen.targets import BLOCK, SOURCES, draw_block, held_out, target_source

TALL = np.repeat(np.linspace(40, 250, 300).astype(np.uint8)[:, None], 170, 1)
"""Photograph that brightens downwards."""


def test_a_piece_shows_the_photograph_within_a_shape():
    rng = np.random.default_rng(4)
    for _ in range(20):
        albedo = piece(TALL, rng)
        lit = albedo > 0
        assert albedo.shape == (64, 64)
        assert albedo.max() == 1.0
        assert 10 < lit.sum() < 0.9 * lit.size
        rows = [row[row > 0] for row in albedo if (row > 0).any()]
        assert max(np.ptp(row) for row in rows) < 1e-3  # the same brightness along each row
        means = np.array([row.mean() for row in rows])
        assert (np.diff(means) > -1e-4).all()


def test_pieces_have_the_side_asked_for():
    assert piece(TALL, np.random.default_rng(2), 96).shape == (96, 96)


def test_mixed_targets_hold_pieces_of_one_photograph_per_block(tmp_path):
    Image.fromarray(TALL).save(tmp_path / "a.png")
    photographs = find_photographs(tmp_path)
    block = SOURCES["mixed"].index("pieces")
    targets, validation = draw_block(target_source("mixed", photographs), 3, block)
    assert targets.shape == (BLOCK, 64, 64)
    assert targets.dtype == np.uint8
    assert (targets.max((1, 2)) == 255).all()
    assert len(np.unique(targets)) > 50  # grey, not black and white
    assert validation == held_out(photographs.hashes[0])
    assert "pieces" not in target_source("mixed", None).kinds
