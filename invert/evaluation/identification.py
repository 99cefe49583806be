"""Identification of the character that a reconstruction shows, by templates in all poses of a tilted, roughly upright object."""

from __future__ import annotations

import string
from functools import lru_cache
from itertools import product

import numpy as np
import torch
from PIL import Image, ImageDraw

from correlograph.lags import OBJECT_SIDE
from data_gen.fonts import dejavu_sans
from invert.albedo.registration import correlation_maps, on_grid

CHARACTERS = string.ascii_uppercase + string.digits + "abdefghnqrty"
"""Capitals, digits, and those small letters that differ from their capital."""

_PADDING_PIXELS = 32
"""Zeros beside template and reconstruction, so that a circular shift loses nothing."""

_TURNS_DEG = (-30, -20, -10, 0, 10, 20, 30)
_SHEARS = (-0.4, -0.2, 0.0, 0.2, 0.4)
_STRETCHES = (0.6, 1.0, 1.7, 2.5)
_SIZES = (0.85, 1.0)
"""Poses of a template: those of a letter that stands roughly upright and is tilted by up to 65 degrees."""

_COMPRESSION = 0.7
"""Power of the brightness, because illumination is seldom uniform."""


@lru_cache(maxsize=4)
def glyphs(characters: str = CHARACTERS) -> np.ndarray:
    """Return characters of DejaVu Sans as white on black, float32 (n, 256, 256), centred."""
    font = dejavu_sans(150)
    drawn = []
    for character in characters:
        canvas = Image.new("L", (256, 256))
        ImageDraw.Draw(canvas).text((128, 128), character, fill=255, font=font, anchor="mm")
        drawn.append(np.asarray(canvas, np.float32) / 255.0)
    return np.stack(drawn)


def identify(image: np.ndarray, *, mirrored: bool = False, characters: str = CHARACTERS) -> list[tuple[str, float]]:
    """Rank characters by their highest registered correlation with a reconstruction.

    Each template takes every pose of a tilted, roughly upright object: rotated by up to 30 degrees, sheared, stretched along the rows,
    and scaled to the extent of the reconstruction. It is then registered over all shifts and the rotation by 180 degrees. Brightness
    is compressed (power 0.7), because a character is one material under illumination that is seldom uniform.

    Args:
        image: reconstruction (64, 64).
        mirrored: whether to try mirrored templates as well, for captures whose axes are those of the wall, in which the
            object may appear mirrored.

    Returns:
        (character, correlation), best first.
    """
    target = np.clip(image.astype(np.float64), 0.0, None) ** _COMPRESSION
    if target.sum() == 0.0:
        return [(character, 0.0) for character in characters]
    spread = float(torch.sqrt(torch.trace(_covariance(torch.as_tensor(target)))))
    templates = torch.from_numpy(glyphs(characters))[:, None]
    covariance = _covariance(templates[:, 0].double())
    reference = on_grid(target, OBJECT_SIDE + _PADDING_PIXELS)
    best = torch.zeros(len(characters))
    flips = (1.0, -1.0) if mirrored else (1.0,)
    for flip, turn, shear, stretch, size in product(flips, _TURNS_DEG, _SHEARS, _STRETCHES, _SIZES):
        warped = _warp(templates, covariance, _pose(flip, turn, shear, stretch), size * spread)
        maps = correlation_maps(torch.nn.functional.pad(warped, (0, _PADDING_PIXELS, 0, _PADDING_PIXELS)), reference)
        best = torch.maximum(best, maps.amax((1, 2, 3)))
    order = best.argsort(descending=True)
    return [(characters[int(i)], float(best[i])) for i in order]


def _pose(flip: float, turn_deg: float, shear: float, stretch: float) -> torch.Tensor:
    """Return the linear map of a pose, (2, 2) in (column, row) order: mirror, then rotate, shear, stretch."""
    angle = np.deg2rad(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return torch.as_tensor(np.diag([stretch**0.5, stretch**-0.5]) @ [[1.0, shear], [0.0, 1.0]] @ turn @ np.diag([flip, 1.0]))


def _covariance(image: torch.Tensor) -> torch.Tensor:
    """Return the covariance of an image's light, pixels squared, (..., 2, 2) in (column, row) order."""
    n_row, n_column = image.shape[-2:]
    row = torch.arange(n_row, dtype=image.dtype)[:, None].expand(n_row, n_column)
    column = torch.arange(n_column, dtype=image.dtype)[None].expand(n_row, n_column)
    place = torch.stack((column, row)).flatten(1)
    mass = image.flatten(-2) / image.sum((-2, -1)).unsqueeze(-1)
    mean = mass @ place.T
    offset = place - mean.unsqueeze(-1)
    return torch.einsum("...n,...in,...jn->...ij", mass, offset, offset)


def _warp(templates: torch.Tensor, covariance: torch.Tensor, pose: torch.Tensor, size: float) -> torch.Tensor:
    """Return templates (n, 1, 256, 256) in a pose, scaled to an extent of `size` pixels, on (n, 64, 64)."""
    scale = size / torch.sqrt(torch.diagonal(pose @ covariance @ pose.T, dim1=-2, dim2=-1).sum(-1))
    inverse = torch.linalg.inv(scale[:, None, None] * pose)
    # affine_grid maps output coordinates in [-1, 1] (32 pixels) to input ones (128 pixels)
    theta = torch.cat((inverse * (OBJECT_SIDE / templates.shape[-1]), torch.zeros(len(templates), 2, 1)), dim=2).float()
    grid = torch.nn.functional.affine_grid(theta, [len(templates), 1, OBJECT_SIDE, OBJECT_SIDE], align_corners=False)
    return torch.nn.functional.grid_sample(templates, grid, align_corners=False)[:, 0]
