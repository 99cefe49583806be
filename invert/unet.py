"""Networks from autocorrelation to albedo: this project's U-net, and the paper's as the baseline.

The paper's: section 5.D, after Ronneberger et al., MICCAI 2015, doi:10.1007/978-3-319-24574-4_28.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from invert.features import CHANNELS, Observation, features, modulus_picture, paper_picture
from invert.registration import laid_over


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions behind group norms, added to their input."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1, self.conv1 = nn.GroupNorm(8, inputs), nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2, self.conv2 = nn.GroupNorm(8, outputs), nn.Conv2d(outputs, outputs, 3, padding=1)
        self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else nn.Identity()
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.conv1(functional.silu(self.norm1(x)))
        return self.skip(x) + self.conv2(functional.silu(self.norm2(y)))


class Attention(nn.Module):
    """Self-attention over all places of a feature map: phase retrieval is not local."""

    def __init__(self, channels: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm, self.qkv = nn.GroupNorm(8, channels), nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        n, channels, height, width = x.shape
        parts = self.qkv(self.norm(x)).reshape(n, 3, self.heads, channels // self.heads, height * width)
        query, key, value = parts.transpose(-1, -2).unbind(1)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        return x + self.out(mixed.transpose(-1, -2).reshape(n, channels, height, width))


class Unet(nn.Module):
    """Features of an estimate (n, CHANNELS, 32, 32), with or without pictures, to albedo (n, 64, 64), zero or more, and the
    correlation with the truth that it expects of itself (n,), as a logit.

    Most work is done at a half and less of the albedo's resolution, because what an autocorrelation tells is global.
    Pictures (n, `pictures`, 64, 64) are among the features and also added to the drawing, as far as each place trusts them.
    """

    def __init__(self, width: int, pictures: int = 0) -> None:
        super().__init__()
        w1, w2, w3 = width, 2 * width, 4 * width
        self.stem = nn.Conv2d(CHANNELS + 4 * pictures, w1, 3, padding=1)
        self.down1 = nn.Sequential(ResidualBlock(w1, w1), ResidualBlock(w1, w1))
        self.pool1 = nn.Conv2d(w1, w2, 2, stride=2)
        self.down2 = nn.Sequential(ResidualBlock(w2, w2), ResidualBlock(w2, w2), Attention(w2))
        self.pool2 = nn.Conv2d(w2, w3, 2, stride=2)
        self.middle = nn.Sequential(ResidualBlock(w3, w3), Attention(w3), ResidualBlock(w3, w3), Attention(w3),
                                    ResidualBlock(w3, w3))
        self.expand2 = nn.Conv2d(w3, 4 * w2, 1)
        self.up2 = nn.Sequential(ResidualBlock(2 * w2, w2), Attention(w2), ResidualBlock(w2, w2))
        self.expand1 = nn.Conv2d(w2, 4 * w1, 1)
        self.up1 = nn.Sequential(ResidualBlock(2 * w1, w1), ResidualBlock(w1, w1), ResidualBlock(w1, w1))
        self.expand0 = nn.Conv2d(w1, 4 * (w1 // 2), 1)
        self.fine = ResidualBlock(w1 // 2, w1 // 2)
        self.draw = nn.Sequential(nn.GroupNorm(8, w1 // 2), nn.SiLU(), nn.Conv2d(w1 // 2, 1 + pictures, 3, padding=1))
        nn.init.constant_(self.draw[-1].bias[1:], 1.5)  # begin by trusting
        self.judge = nn.Sequential(nn.Linear(w3 + w1, w2), nn.SiLU(), nn.Linear(w2, 1))

    def forward(self, features: torch.Tensor, pictures: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        if pictures is not None:
            features = torch.cat((features, functional.pixel_unshuffle(pictures, 2)), 1)
        level1 = self.down1(self.stem(features))
        level2 = self.down2(self.pool1(level1))
        middle = self.middle(self.pool2(level2))
        up2 = self.up2(torch.cat((functional.pixel_shuffle(self.expand2(middle), 2), level2), 1))
        up1 = self.up1(torch.cat((functional.pixel_shuffle(self.expand1(up2), 2), level1), 1))
        drawn = self.draw(self.fine(functional.pixel_shuffle(self.expand0(up1), 2))).float()
        albedo = drawn[:, 0] if pictures is None else drawn[:, 0] + (drawn[:, 1:] * pictures).sum(1)
        seen = torch.cat((middle.mean((-2, -1)), up1.mean((-2, -1))), 1)
        return functional.softplus(albedo), self.judge(seen.detach())[:, 0].float()


class CorrelographyNet(nn.Module):
    """Two U-nets: `alone` draws from the estimate; `fusion` sees that, and two classical pictures laid over it, as well.

    Where the classical reconstruction is good, it is kept and cleaned; where it is not, the first picture stands.
    """

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.alone = Unet(width)
        self.fusion = Unet(width // 2, pictures=3)
        self.fuses = False
        """Whether to fuse even where nothing classical is shown, as in training the fusion."""

    def forward(self, seen: Observation) -> tuple[torch.Tensor, torch.Tensor]:
        shown = features(seen).to(memory_format=torch.channels_last)
        first, expected = self.alone(shown)
        if not (self.fuses or bool(seen.classical.any())):
            return first, expected
        look = (first / first.amax((-2, -1), keepdim=True).clamp_min(1e-6)).detach()
        return self.fusion(shown, torch.cat((look[:, None], laid_over(seen.classical, look)), 1))


class PaperUnet(nn.Module):
    """The paper's U-net: 12 convolutional layers of 64 to 512 channels, batch norm; it has no expectation of itself."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        w = [width, 2 * width, 4 * width, 8 * width]

        def convolution(inputs: int, outputs: int) -> nn.Module:
            return nn.Sequential(nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs),
                                 nn.ReLU(inplace=True))

        self.down = nn.ModuleList(nn.Sequential(convolution(inputs, outputs), convolution(outputs, outputs))
                                  for inputs, outputs in zip([1, *w[:3]], w, strict=True))
        self.up = nn.ModuleList(convolution(coarse + fine, fine) for coarse, fine in zip(w[:0:-1], w[-2::-1], strict=True))
        self.draw = nn.Conv2d(width, 1, 3, padding=1)

    def picture(self, seen: Observation) -> torch.Tensor:
        return paper_picture(seen.estimate)

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
    """The same shown |F(r)| instead of r*r: the mapping that section 5.C of the paper found harder to learn."""

    def picture(self, seen: Observation) -> torch.Tensor:
        return modulus_picture(seen.estimate, seen.floor)
