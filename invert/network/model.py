"""The network: U-nets that denoise an autocorrelation, sketch the object, fuse classical reconstructions, and sample the
posterior."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from invert.albedo.registration import register_groups
from invert.network.blocks import GROUPS, Decoder, Unet
from invert.network.features import (
    FUSION_CHANNELS,
    LAG_CHANNELS,
    PICTURES,
    SKETCH_CHANNELS,
    Observation,
    half_plane,
    lag_features,
    picture_features,
    sketch_features,
    whole_plane,
)
from invert.network.sampler import Sampler


class Denoiser(nn.Module):
    """Signal H (r*r) of an estimate, without floor and noise, zero lag included.

    An autocorrelation, unlike the object, has neither shift nor twin image, so there is a single correct output. Phase retrieval
    itself is done by projections.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet = Unet(LAG_CHANNELS, width)
        self.draw = nn.Sequential(nn.GroupNorm(GROUPS, width), nn.SiLU(), nn.Conv2d(width, 8, 3, padding=1))

    def forward(self, seen: Observation) -> torch.Tensor:
        """Return the signal (n, 127, 127), centro-symmetric, in the unit of the estimate."""
        shown, relative, height = lag_features(seen)
        drawn = functional.pixel_shuffle(self.draw(self.unet(shown.to(memory_format=torch.channels_last))[0]), 2).float()
        # each lag is a weighted mean of measured and predicted value
        trust = torch.sigmoid(drawn[:, 0])
        signal = trust * half_plane(relative) + (1.0 - trust) * functional.softplus(drawn[:, 1] - 3.0)
        return whole_plane(signal) * height[:, None, None]


class Sketch(nn.Module):
    """Coarse image (n, 64, 64), zero or more, from the estimate: object and twin image superimposed.

    It does not choose between the object and its twin image, because the estimate alone does not determine that choice.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet, self.drawing = Unet(SKETCH_CHANNELS, width), Decoder(width, 1)

    def forward(self, seen: Observation) -> torch.Tensor:
        level, _ = self.unet(sketch_features(seen).to(memory_format=torch.channels_last))
        return functional.softplus(self.drawing(level)[:, 0])


class Fusion(nn.Module):
    """Albedo (n, 64, 64), zero or more, from the estimate and classical reconstructions, with its predicted correlation.

    The prediction is the logit of the correlation with the truth, (n,).

    The reconstructions are inputs and are also added to the output, with a weight for each pixel: a good one is kept and cleaned, a
    bad one suppressed.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet = Unet(FUSION_CHANNELS + 4 * (1 + PICTURES), width)
        self.drawing = Decoder(width, 2 + PICTURES)
        nn.init.constant_(self.drawing.draw[-1].bias[1:], 1.0)  # weights near 1
        self.judge = nn.Sequential(nn.Linear(5 * width, 2 * width), nn.SiLU(), nn.Linear(2 * width, 1))

    def forward(self, seen: Observation, pictures: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        shown = torch.cat((picture_features(seen), functional.pixel_unshuffle(pictures, 2)), 1)
        level, coarsest = self.unet(shown.to(memory_format=torch.channels_last))
        drawn = self.drawing(level)
        albedo = functional.softplus(drawn[:, 0] + (drawn[:, 1:] * pictures).sum(1))
        seen_by_judge = torch.cat((coarsest, level.mean((-2, -1))), 1).detach()
        return albedo, self.judge(seen_by_judge)[:, 0].float()


class CorrelographyNet(nn.Module):
    """All four parts. Phase retrieval runs between denoiser and fusion; annealing with the sampler follows (`inference.py`)."""

    def __init__(self, width: int = 40) -> None:
        super().__init__()
        self.denoiser = Denoiser(width)
        self.sketch = Sketch(width)
        self.fusion = Fusion(width)
        self.sampler = Sampler(width)

    def forward(self, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        """Sketch the object, register the classical reconstructions to the sketch, and fuse them."""
        sketch = self.sketch(seen)
        sketch = sketch / sketch.amax((-2, -1), keepdim=True).clamp_min(1e-6)
        return self.fusion(seen, torch.cat((sketch[:, None], register_groups(seen.classical, sketch)), 1))
