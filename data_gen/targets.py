"""Targets by source, in blocks that depend only on the seed and the number of the block.

A block holds `BLOCK` targets of one origin: edges of one photograph in one view, pieces of one photograph, variants of one glyph,
strokes, or filled shapes.
Training and validation are split by origin, never by crop.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from correlograph.errors import InputError
from correlograph.lags import OBJECT_SIDE
from data_gen.edges import Photographs, edge_targets, read_luminance
from data_gen.pages import page
from data_gen.pieces import piece
from data_gen.shapes import ALPHABET, filled_shape, glyph, strokes

BLOCK = 64
"""Targets per origin."""

VALIDATION_SHARE = 0.1

SOURCES = {
    "edges": ("edges",),
    "glyphs": ("glyphs",),
    "strokes": ("strokes",),
    "shapes": ("filled", "strokes"),
    "pages": ("pages",),
    "mixed": ("edges", "glyphs", "strokes", "edges", "pieces", "filled"),
    "all": ("edges", "glyphs", "strokes", "pieces", "filled", "pages", "pages"),
}
"""Names on the command line, and the kinds of target in rotation."""

OF_PHOTOGRAPHS = ("edges", "pieces")
"""Kinds that need photographs."""


@dataclass(frozen=True)
class TargetSource:
    """Source of targets: kinds in rotation; photographs for edges and pieces; side of a target in lags."""

    kinds: tuple[str, ...]
    photographs: Photographs | None = None
    side: int = OBJECT_SIDE


def target_source(name: str, photographs: Photographs | None, side: int = OBJECT_SIDE) -> TargetSource:
    """Return a source by name; `mixed` and `all` have no edges and pieces without photographs."""
    kinds = SOURCES[name]
    if photographs is None:
        if name == "edges":
            raise InputError("--source", "photographs for edges", "none", "add --images FOLDER")
        kinds = tuple(kind for kind in kinds if kind not in OF_PHOTOGRAPHS)
    return TargetSource(kinds, photographs, side)


def held_out(origin: str) -> bool:
    """Return whether an origin (hash of a photograph, character, number of a block) belongs to validation."""
    digest = hashlib.sha256(origin.encode()).digest()
    return int.from_bytes(digest[:8], "big") < VALIDATION_SHARE * 2.0**64


def draw_block(source: TargetSource, seed: int, block: int) -> tuple[np.ndarray, bool]:
    """Return the targets of a block, uint8 (BLOCK, side, side), 255 for albedo 1, and whether they are for validation.

    Raises InputError if no photograph has enough edges.
    """
    rng = np.random.default_rng([seed, block])
    kind = source.kinds[block % len(source.kinds)]
    if kind == "edges":
        return _edge_block(source, rng)
    if kind == "pieces":
        return _piece_block(source, rng)
    if kind == "glyphs":
        character = ALPHABET[rng.integers(len(ALPHABET))]
        return np.stack([glyph(character, rng, source.side) for _ in range(BLOCK)]), held_out(character)
    draw = {"strokes": strokes, "filled": filled_shape, "pages": page}[kind]
    return np.stack([draw(rng, source.side) for _ in range(BLOCK)]), held_out(f"{kind} {block}")


def _piece_block(source: TargetSource, rng: np.random.Generator) -> tuple[np.ndarray, bool]:
    photographs = source.photographs
    assert photographs is not None
    index = int(rng.integers(len(photographs.names)))
    luminance = read_luminance(photographs.folder / photographs.names[index])
    targets = np.stack([piece(luminance, rng, source.side) for _ in range(BLOCK)])
    return np.round(255.0 * targets).astype(np.uint8), held_out(photographs.hashes[index])


def _edge_block(source: TargetSource, rng: np.random.Generator) -> tuple[np.ndarray, bool]:
    photographs = source.photographs
    assert photographs is not None
    for index in rng.permutation(len(photographs.names)):
        targets = edge_targets(read_luminance(photographs.folder / photographs.names[index]), BLOCK, rng, source.side)
        if targets is not None:
            return targets, held_out(photographs.hashes[index])
    raise InputError(
        "--images",
        f"photographs with crops of {source.side} x {source.side} pixels that hold edges",
        "none",
        "use another folder",
    )
