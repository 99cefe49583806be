"""Synthetic targets: glyphs of non-Latin scripts, strokes, filled shapes; `data_gen.pages` has pages of text.

They are rendered four times larger than the lag grid and averaged over cells, so edges are grey like the cell means of an albedo.
Latin letters and digits are reserved for the tests: no target shows one.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from correlograph.lags import OBJECT_SIDE
from data_gen.fonts import dejavu_sans

FINE = 4

ALPHABET = "γδεζθλμξπστφψΔΘΞΠΦΨΩгджйлфцшщъыюяДЖЛФЦШЩЮאבגדהזחטכלמנספצקשת←↑→↔⇒∂∇∑√∞∫≈≠≤≥⊕⊗★♠♣♥♪✈✓✚"
"""Characters of DejaVu Sans that cannot be mistaken for a Latin letter or digit, even mirrored or rotated."""

FONTS = (("normal", "normal"), ("bold", "normal"), ("normal", "oblique"))
"""Weight and style."""


ASPECT = 3.0
"""Maximum ratio of the stretches along the two axes, as by a tilted wall."""


def glyph(character: str, rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray:
    """Return a character of random font, size, slant and rotation, uint8 (side, side)."""
    full = side * FINE
    canvas = Image.new("L", (full, full))
    font = dejavu_sans(150 * side // OBJECT_SIDE, *FONTS[rng.integers(len(FONTS))])
    ImageDraw.Draw(canvas).text((full // 2, full // 2), character, fill=255, font=font, anchor="mm")
    box = canvas.getbbox()
    if box is None:
        raise ValueError(f"DejaVu Sans has no character {character!r}")
    stretch = np.diag(_stretch(rng))
    angle = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else rng.normal(0.0, 0.3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shape = turn @ np.array([[1.0, rng.normal(0.0, 0.2)], [0.0, 1.0]]) @ stretch
    corners = shape @ np.array([[-1, 1, -1, 1], [-1, -1, 1, 1]]) * 0.5 * np.array([[box[2] - box[0]], [box[3] - box[1]]])
    extent = float(np.ptp(corners, axis=1).max())
    inverse = np.linalg.inv(shape * (side / OBJECT_SIDE * FINE * rng.uniform(18.0, 54.0) / extent))
    middle = np.array([0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])])
    offset = middle - inverse @ np.full(2, full / 2)
    coefficients = (*inverse[0], offset[0], *inverse[1], offset[1])
    return cell_means(canvas.transform(canvas.size, Image.Transform.AFFINE, coefficients, Image.Resampling.BILINEAR), rng)


def _stretch(rng: np.random.Generator) -> np.ndarray:
    """Return factors along the two axes, the larger one 1; half of all objects keep their proportions."""
    aspect = ASPECT ** rng.uniform(-1.0, 1.0) if rng.random() < 0.5 else 1.0
    return np.minimum(1.0, np.array([aspect, 1.0 / aspect]))


def strokes(rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray:
    """Return one to four pen strokes (quadratic curves and corners), more in a larger window; uint8 (side, side)."""
    full, larger = side * FINE, side / OBJECT_SIDE
    canvas = Image.new("L", (full, full))
    pen = ImageDraw.Draw(canvas)
    reach = 0.5 * larger * FINE * rng.uniform(18.0, 52.0) * _stretch(rng)
    thickness = FINE * rng.uniform(1.2, 6.5 * larger)
    start = rng.uniform(-reach, reach, 2)
    for _ in range(rng.integers(1, int(1 + 4 * larger**2))):
        end = rng.uniform(-reach, reach, 2)
        if rng.random() < 0.5:
            path = np.stack([start, end])
        else:
            bend, along = rng.uniform(-reach, reach, 2), np.linspace(0.0, 1.0, 24)[:, None]
            path = (1 - along) ** 2 * start + 2 * along * (1 - along) * bend + along**2 * end
        points = [tuple(point) for point in path + full / 2]
        pen.line(points, fill=255, width=max(1, round(thickness)), joint="curve")
        for x, y in (points[0], points[-1]):
            pen.ellipse((x - thickness / 2, y - thickness / 2, x + thickness / 2, y + thickness / 2), fill=255)
        start = end if rng.random() < 0.6 else rng.uniform(-reach, reach, 2)
    return cell_means(canvas, rng)


def filled_shape(rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray:
    """Return one to three filled polygons and ellipses of different albedo, some with a hole; uint8 (side, side)."""
    full = side * FINE
    canvas = Image.new("L", (full, full))
    pen = ImageDraw.Draw(canvas)
    reach = 0.5 * side / OBJECT_SIDE * FINE * rng.uniform(16.0, 46.0) * _stretch(rng)
    for _ in range(rng.integers(1, 4)):
        centre = full / 2 + rng.uniform(-0.6, 0.6, 2) * reach
        size = reach * rng.uniform(0.25, 0.8)
        albedo = int(rng.integers(90, 256))
        for radius, fill in ((size, albedo), (size * rng.uniform(0.3, 0.7), 0)):
            if rng.random() < 0.35:
                half_axes = radius * np.array([1.0, rng.uniform(0.6, 1.0)])
                pen.ellipse((*(centre - half_axes), *(centre + half_axes)), fill=fill)
            else:
                angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 8)))
                distance = rng.uniform(0.6, 1.2, angle.size)
                corner = centre + radius * distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
                pen.polygon([tuple(point) for point in corner], fill=fill)
            if rng.random() < 0.5:
                break
    return cell_means(canvas, rng)


def cell_means(canvas: Image.Image, rng: np.random.Generator) -> np.ndarray:
    """Return cell means, with a probability of 1/3 multiplied by a random smooth illumination; empty images get a square."""
    fine = np.asarray(canvas, np.float32)
    side = len(fine) // FINE
    cells = fine.reshape(side, FINE, side, FINE).mean((1, 3))
    if rng.random() < 0.33:
        light = ndimage.gaussian_filter(rng.standard_normal((side, side)), 12.0 * side / OBJECT_SIDE)
        cells = cells * np.clip(0.7 + 0.3 * light / light.std(), 0.25, 1.0)
    if cells.max() < 64.0:
        cells[3 * side // 8 : 5 * side // 8, 13 * side // 32 : 19 * side // 32] = 255.0
    return np.round(cells).astype(np.uint8)
