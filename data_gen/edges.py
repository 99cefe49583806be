"""Canny edges of photographs as targets: the training data of Metzler et al. 2020, section 5.A.

A photograph is rotated, scaled and passed through a Canny edge detector (Canny, IEEE TPAMI 8(6), 679, 1986,
doi:10.1109/TPAMI.1986.4767851). Crops become targets if they have neither too few nor too many edge pixels.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage
from skimage.feature import canny

from correlograph.errors import InputError
from correlograph.lags import OBJECT_SIDE

WINDOW = (36, 60)
"""Minimum and maximum side of a crop, which is centred in a target of 64 pixels; larger targets have larger crops."""

MIN_EDGE_PIXELS, MAX_EDGE_FRACTION = 48, 0.16
"""Minimum number of edge pixels of a target, and maximum fraction of the crop that may be edge."""

MIN_COMPONENT_PIXELS = 10
"""Minimum number of pixels of connected edges; smaller ones are removed, because an estimate would not show them."""

MIN_SIDE = 2 * OBJECT_SIDE
"""Minimum side of a photograph; smaller ones hold too few crops."""

VIEWS = 6
"""Views of a photograph before it counts as one without edges."""

KINDS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")


@dataclass(frozen=True)
class Photographs:
    """Usable photographs by name, the SHA-256 of each, and skipped files with the reason."""

    folder: Path
    names: tuple[str, ...]
    hashes: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]


def find_photographs(folder: Path) -> Photographs:
    """Find photographs in a folder and its sub-folders. Raises InputError if there is none.

    Damaged, tiny and other files are listed in `skipped`. Grey-scale and CMYK photographs are read as luminance.
    """
    if not folder.is_dir():
        raise InputError("--images", "a folder of photographs", f"no {folder}", "check the path")
    names, hashes, skipped = [], [], []
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = file.relative_to(folder).as_posix()
        reason = None
        if file.suffix.lower() not in KINDS:
            reason = "not a picture"
        else:
            try:
                luminance = read_luminance(file)
                if min(luminance.shape) < MIN_SIDE:
                    reason = f"only {luminance.shape[1]} x {luminance.shape[0]} pixels"
                elif np.ptp(luminance) == 0.0:
                    reason = "the same value everywhere"
            except Exception as error:  # every decoder raises its own exceptions
                reason = f"cannot be read ({type(error).__name__})"
        if reason:
            skipped.append((name, reason))
        else:
            names.append(name)
            hashes.append(hashlib.sha256(file.read_bytes()).hexdigest())
    if not names:
        raise InputError(
            "--images",
            f"photographs of at least {MIN_SIDE} x {MIN_SIDE} pixels",
            f"none among {len(skipped)} files in {folder}" + (f" ({skipped[0][0]}: {skipped[0][1]})" if skipped else ""),
            "use another folder",
        )
    return Photographs(folder, tuple(names), tuple(hashes), tuple(skipped))


@lru_cache(maxsize=512)
def read_luminance(file: Path) -> np.ndarray:
    """Return the luminance of a photograph, uint8 (H, W), at most 1024 pixels along a side."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(file) as picture:
            picture.draft("L", (1024, 1024))
            grey = picture.convert("L")
    grey.thumbnail((1024, 1024), Image.Resampling.BOX)
    return np.asarray(grey)


def edge_targets(luminance: np.ndarray, count: int, rng: np.random.Generator, side: int = OBJECT_SIDE) -> np.ndarray | None:
    """Return `count` crops of the edges of one photograph, with one rotation and scale; uint8 (count, side, side), 0 or 255.

    None if the photograph has too few edges at every rotation and scale that was tried.
    """
    for _ in range(VIEWS):
        edges = _edges(luminance, rng, side)
        found = _crops(edges, count, rng, side)
        if found is not None:
            return found
    return None


def _edges(luminance: np.ndarray, rng: np.random.Generator, side: int) -> np.ndarray:
    """Return the Canny edges of a rotated and scaled view, bool."""
    turn, scale = rng.uniform(-180.0, 180.0), 2.0 ** rng.uniform(-1.3, 0.3)
    view = Image.fromarray(luminance)
    size = tuple(max(side, round(length * scale * side / OBJECT_SIDE)) for length in view.size)
    view = view.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    inside = Image.new("L", view.size, 255).rotate(turn, expand=True)
    view = view.rotate(turn, Image.Resampling.BILINEAR, expand=True)
    mask = np.asarray(inside) > 0
    pixels = np.asarray(view, np.float32) / np.float32(255.0)
    return canny(pixels, sigma=rng.uniform(1.0, 2.0), mask=mask)


def _crops(edges: np.ndarray, count: int, rng: np.random.Generator, side: int) -> np.ndarray | None:
    low, high = (limit * side // OBJECT_SIDE for limit in WINDOW)
    height, width = edges.shape
    if min(height, width) <= high:
        return None
    targets = np.zeros((count, side, side), np.uint8)
    accepted = 0
    for _ in range(8 * count):
        cut = int(rng.integers(low, high + 1))
        row, column = int(rng.integers(height - cut)), int(rng.integers(width - cut))
        crop = edges[row : row + cut, column : column + cut]
        if not MIN_EDGE_PIXELS <= np.count_nonzero(crop) <= MAX_EDGE_FRACTION * cut * cut:
            continue
        crop = _remove_small_components(crop)
        if np.count_nonzero(crop) < MIN_EDGE_PIXELS:
            continue
        corner = (side - cut) // 2
        targets[accepted, corner : corner + cut, corner : corner + cut] = crop * np.uint8(255)
        accepted += 1
        if accepted == count:
            return targets
    return None


def _remove_small_components(crop: np.ndarray) -> np.ndarray:
    """Keep connected edges (eight neighbours) of at least `MIN_COMPONENT_PIXELS` pixels."""
    label, _ = ndimage.label(crop, np.ones((3, 3)))
    large = np.bincount(label.ravel()) >= MIN_COMPONENT_PIXELS
    large[0] = False
    return large[label]
