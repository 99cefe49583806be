"""Baseline: the U-net of Metzler et al. 2020, section 5.D, after Ronneberger et al., MICCAI 2015,
doi:10.1007/978-3-319-24574-4_28."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from invert.network.features import Observation, modulus_picture, paper_picture


class PaperUnet(nn.Module):
    """U-net of Metzler et al. 2020: 12 convolutional layers of 64 to 512 channels, batch norm; it predicts no confidence."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        w = [width, 2 * width, 4 * width, 8 * width]

        def convolution(inputs: int, outputs: int) -> nn.Module:
            return nn.Sequential(
                nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
            )

        self.down = nn.ModuleList(
            nn.Sequential(convolution(inputs, outputs), convolution(outputs, outputs))
            for inputs, outputs in zip([1, *w[:3]], w, strict=True)
        )
        self.up = nn.ModuleList(convolution(coarse + fine, fine) for coarse, fine in zip(w[:0:-1], w[-2::-1], strict=True))
        self.draw = nn.Conv2d(width, 1, 3, padding=1)

    def picture(self, seen: Observation) -> torch.Tensor:
        return paper_picture(seen.values)

    def forward(self, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        x, skipped = self.picture(seen).to(memory_format=torch.channels_last), []
        for index, block in enumerate(self.down):
            x = block(functional.max_pool2d(x, 2) if index else x)
            skipped.append(x)
        for block, beside in zip(self.up, skipped[-2::-1], strict=True):
            x = block(torch.cat((functional.interpolate(x, scale_factor=2.0, mode="nearest"), beside), 1))
        albedo = functional.relu(self.draw(x))[:, 0, 32:96, 32:96].float()
        return albedo, albedo.new_zeros(len(albedo))


class PaperModulusUnet(PaperUnet):
    """The same U-net with |F(r)| as its input, a mapping that Metzler et al. 2020 (section 5.C) found harder to learn."""

    def picture(self, seen: Observation) -> torch.Tensor:
        return modulus_picture(seen.values, seen.floor)
