"""Network that despeckles the mean |E|^2 of a few fields.

It has no norm and no attention, so an image of any size is treated as its parts are. The prior of the fields holds speckle of many
kinds of objects (`invert.training.speckle`), Latin letters and digits excepted.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

CELLS = 2
"""Cells per position of the finest level, along both axes."""

LEVELS = 4
"""Levels, each half as fine as the one before."""

MIN_INTENSITY = 1e-2
"""Intensity, in units of the scale, below which the logarithm levels off."""


class PlainBlock(nn.Module):
    """Two 3 x 3 convolutions, added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.conv2(functional.silu(self.conv1(functional.silu(x))))


class Despeckler(nn.Module):
    """Albedo (n, rows, columns), zero or more, from the mean intensity (n, rows, columns) of a number of looks (n,), in its unit.

    A U-net whose finest level has one position per `CELLS` x `CELLS` cells.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        widths = [width * (level + 1) for level in range(LEVELS)]
        self.stem = nn.Conv2d(2 * CELLS**2 + 1, width, 3, padding=1)
        self.down = nn.ModuleList(nn.Sequential(PlainBlock(one), PlainBlock(one)) for one in widths)
        self.pool = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairwise(widths))
        self.expand = nn.ModuleList(nn.Conv2d(coarse, 4 * fine, 1) for fine, coarse in pairwise(widths))
        self.up = nn.ModuleList(nn.Sequential(PlainBlock(one), PlainBlock(one)) for one in widths[:-1])
        self.draw = nn.Conv2d(width, CELLS**2, 3, padding=1)

    def forward(self, intensity: torch.Tensor, looks: torch.Tensor) -> torch.Tensor:
        rows, columns = intensity.shape[-2:]
        scale = intensity.square().mean((-2, -1)) / intensity.mean((-2, -1)).clamp_min(1e-30)
        scale = (scale / (1.0 + 1.0 / looks)).clamp_min(1e-30)[:, None, None]
        unit = CELLS * 2 ** (LEVELS - 1)
        seen = functional.pad(intensity / scale, (0, -columns % unit, 0, -rows % unit))
        shown = torch.stack((seen.sqrt(), (seen + MIN_INTENSITY).log()), 1)
        x = functional.pixel_unshuffle(shown, CELLS)
        level = self.stem(torch.cat((x, looks.rsqrt()[:, None, None, None].expand(-1, 1, *x.shape[-2:])), 1))
        levels = []
        for number, down in enumerate(self.down):
            level = down(level)
            if number < len(self.pool):
                levels.append(level)
                level = self.pool[number](level)
        for kept, expand, up in zip(levels[::-1], self.expand[::-1], self.up[::-1], strict=True):
            level = up(kept + functional.pixel_shuffle(expand(level), 2))
        drawn = functional.pixel_shuffle(self.draw(level), CELLS)[:, 0, :rows, :columns]
        return functional.softplus(drawn.float() - 2.0) * scale
