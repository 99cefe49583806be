"""The network: a U-net that takes the noise out of an autocorrelation, and one that draws what retrieval made of both."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from invert.blocks import GROUPS, ResidualBlock, Unet
from invert.features import (
    FUSION_CHANNELS,
    LAG_CHANNELS,
    PICTURES,
    Observation,
    half_plane,
    lag_features,
    picture_features,
    whole_plane,
)


class Denoiser(nn.Module):
    """The signal H (r*r) of an estimate, without floor and noise, zero lag among it.

    An autocorrelation, unlike the object, has no shift and no half turn, so there is one right answer to learn. Phase
    retrieval itself is left to projections.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet = Unet(LAG_CHANNELS, width)
        self.draw = nn.Sequential(nn.GroupNorm(GROUPS, width), nn.SiLU(), nn.Conv2d(width, 8, 3, padding=1))

    def forward(self, seen: Observation) -> torch.Tensor:
        """Signal (n, 127, 127), centro-symmetric, in the estimate's unit."""
        shown, relative, height = lag_features(seen)
        drawn = functional.pixel_shuffle(self.draw(self.unet(shown.to(memory_format=torch.channels_last))[0]), 2).float()
        # Each lag is measured as far as it can be trusted, and drawn for the rest.
        trust = torch.sigmoid(drawn[:, 0])
        signal = trust * half_plane(relative) + (1.0 - trust) * functional.softplus(drawn[:, 1] - 3.0)
        return whole_plane(signal) * height[:, None, None]


class Fusion(nn.Module):
    """Albedo (n, 64, 64), zero or more, from classical pictures and the estimate, and the correlation with the truth that it
    expects of it (n,), as a logit.

    The pictures are among the features and also added to the drawing, as far as each place trusts them: a good classical
    reconstruction is kept and cleaned, a bad one overruled.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet = Unet(FUSION_CHANNELS + 4 * PICTURES, width)
        self.expand = nn.Conv2d(width, 2 * width, 1)
        self.fine = ResidualBlock(width // 2, width // 2)
        self.draw = nn.Sequential(nn.GroupNorm(GROUPS, width // 2), nn.SiLU(),
                                  nn.Conv2d(width // 2, 1 + PICTURES, 3, padding=1))
        nn.init.constant_(self.draw[-1].bias[1:], 1.5)  # begin by trusting
        self.judge = nn.Sequential(nn.Linear(5 * width, 2 * width), nn.SiLU(), nn.Linear(2 * width, 1))

    def forward(self, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        shown = torch.cat((picture_features(seen), functional.pixel_unshuffle(seen.classical, 2)), 1)
        level, coarsest = self.unet(shown.to(memory_format=torch.channels_last))
        drawn = self.draw(self.fine(functional.pixel_shuffle(self.expand(level), 2))).float()
        albedo = functional.softplus(drawn[:, 0] + (drawn[:, 1:] * seen.classical).sum(1))
        seen_by_judge = torch.cat((coarsest, level.mean((-2, -1))), 1).detach()
        return albedo, self.judge(seen_by_judge)[:, 0].float()


class CorrelographyNet(nn.Module):
    """Both. Between them stands classical phase retrieval (`invert/methods.py`)."""

    def __init__(self, width: int = 40) -> None:
        super().__init__()
        self.denoiser = Denoiser(width)
        self.fusion = Fusion(width)

    def forward(self, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        return self.fusion(seen)
