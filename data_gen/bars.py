"""Resolution target: groups of five bars, 30 to 300 um wide, along both axes; `python -m data_gen.bars FILE.png` writes it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from correlograph.command import run_command
from correlograph.files.output import atomic

SIDE_M = 0.01
"""Side of the target."""

PIXELS = 2000
"""Pixels along a side; each is 5 um wide."""

BARS = 5
WIDE_UM, NARROW_UM = (300, 200, 150, 100), (75, 50, 40, 30)
MIN_LENGTH_UM, GAP_UM = 1000, 500
"""Minimum length of a bar, and distance between groups."""


@dataclass(frozen=True)
class BarGroup:
    """Bars of one width and direction; position of its first corner (row, column) in metres from the corner of the target.

    Attributes:
        is_upright: whether the bars run along the columns' direction, from top to bottom.
    """

    width_m: float
    is_upright: bool
    corner_m: tuple[float, float]

    @property
    def across_m(self) -> float:
        """Extent of the group across its bars."""
        return (2 * BARS - 1) * self.width_m

    @property
    def length_m(self) -> float:
        return max(self.across_m, MIN_LENGTH_UM * 1e-6)


def bar_groups() -> list[BarGroup]:
    """Return the groups: wide upright bars in a first row, wide level bars in a second one, narrow bars in a third one."""
    groups, top = [], 400
    for widths, directions in ((WIDE_UM, (True,)), (WIDE_UM, (False,)), (NARROW_UM, (True, False))):
        left, tallest = 500, 0
        for width, is_upright in ((width, upright) for upright in directions for width in widths):
            group = BarGroup(width * 1e-6, is_upright, (top * 1e-6, left * 1e-6))
            across, length = round(group.across_m * 1e6), round(group.length_m * 1e6)
            left += (across if is_upright else length) + GAP_UM
            tallest = max(tallest, length if is_upright else across)
            groups.append(group)
        top += tallest + GAP_UM
    return groups


def bar_target() -> np.ndarray:
    """Return the target, white bars on black, uint8 (PIXELS, PIXELS)."""
    canvas = np.zeros((PIXELS, PIXELS), np.uint8)
    pixel_m = SIDE_M / PIXELS
    for group in bar_groups():
        for bar in range(BARS):
            first = np.array(group.corner_m)
            first[1 if group.is_upright else 0] += 2 * bar * group.width_m
            size = (group.length_m, group.width_m) if group.is_upright else (group.width_m, group.length_m)
            (top, bottom), (left, right) = (
                (round(start / pixel_m), round((start + extent) / pixel_m)) for start, extent in zip(first, size, strict=True)
            )
            canvas[top:bottom, left:right] = 255
    return canvas


def bar_contrast(albedo: np.ndarray, group: BarGroup) -> float:
    """Return the contrast of a group: amplitude of the wave with the period of its bars over the mean, 1 for the target itself.

    The phase of the wave is free, so that a registration error of a fraction of a bar has no effect.

    Args:
        albedo: registered albedo of the target, (rows, columns) over its whole side.
    """
    pitch_m = [SIDE_M / side for side in albedo.shape]
    row, column = ((np.arange(side) + 0.5) * pitch for side, pitch in zip(albedo.shape, pitch_m, strict=True))
    across, along = (column, row) if group.is_upright else (row, column)
    place = across - group.corner_m[1 if group.is_upright else 0]
    end = along - group.corner_m[0 if group.is_upright else 1]
    shown = (place > group.width_m) & (place < (2 * BARS - 3) * group.width_m)  # whole periods away from the ends
    kept = (end > 0.1 * group.length_m) & (end < 0.9 * group.length_m)
    profile = (albedo[kept] if group.is_upright else albedo[:, kept].T).mean(0)[shown]
    if profile.sum() <= 0.0:
        return 0.0
    amplitude = abs((profile * np.exp(1j * np.pi * place[shown] / group.width_m)).sum()) / profile.sum()
    return float(amplitude * 0.5 * np.pi)  # the first harmonic of bars and gaps of equal width is 2 / pi of their mean


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m data_gen.bars", description=__doc__)
    parser.add_argument("output", type=Path)
    options = parser.parse_args(argv)
    with atomic(options.output) as partial:
        Image.fromarray(bar_target()).save(partial, format="PNG", optimize=True)


if __name__ == "__main__":
    run_command(main)
