"""Building blocks of the networks: precision, residual blocks, self-attention, U-net, decoder."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

GROUPS = 4
"""Channel groups of every group norm."""


def autocast(device: torch.device) -> torch.autocast:
    """Return the context in which networks run: bfloat16 where the processor computes in it, float32 elsewhere.

    Processors without AVX-512 emulate bfloat16 so slowly that a convolution takes up to 100 times as long as in float32.
    """
    is_computed = device.type != "cpu" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=is_computed)


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions after group norms, added to their input."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1, self.conv1 = nn.GroupNorm(GROUPS, inputs), nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2, self.conv2 = nn.GroupNorm(GROUPS, outputs), nn.Conv2d(outputs, outputs, 3, padding=1)
        self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else nn.Identity()
        nn.init.zeros_(self.conv2.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.conv1(functional.silu(self.norm1(x)))
        return self.skip(x) + self.conv2(functional.silu(self.norm2(y)))


class Attention(nn.Module):
    """Self-attention over all positions of a feature map, because each lag involves the whole object."""

    def __init__(self, channels: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm, self.qkv = nn.GroupNorm(GROUPS, channels), nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        n, channels, height, width = x.shape
        parts = self.qkv(self.norm(x)).reshape(n, 3, self.heads, channels // self.heads, height * width)
        query, key, value = parts.transpose(-1, -2).unbind(1)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        return x + self.out(mixed.transpose(-1, -2).reshape(n, channels, height, width))


class Unet(nn.Module):
    """U-net of three levels with `width`, 2 `width` and 4 `width` channels; attention at the coarsest.

    It maps (n, inputs, h, w) to (n, width, h, w), and returns the mean of the coarsest level (n, 4 width) as well.
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        w1, w2, w3 = width, 2 * width, 4 * width
        self.stem = nn.Conv2d(inputs, w1, 3, padding=1)
        self.down1 = ResidualBlock(w1, w1)
        self.pool1 = nn.Conv2d(w1, w2, 2, stride=2)
        self.down2 = nn.Sequential(ResidualBlock(w2, w2), ResidualBlock(w2, w2))
        self.pool2 = nn.Conv2d(w2, w3, 2, stride=2)
        self.middle = nn.Sequential(*(block(w3) for _ in range(3) for block in (lambda w: ResidualBlock(w, w), Attention)))
        self.expand2 = nn.Conv2d(w3, 4 * w2, 1)
        self.up2 = nn.Sequential(ResidualBlock(2 * w2, w2), ResidualBlock(w2, w2))
        self.expand1 = nn.Conv2d(w2, 4 * w1, 1)
        self.up1 = nn.Sequential(ResidualBlock(2 * w1, w1), ResidualBlock(w1, w1))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        level1 = self.down1(self.stem(x))
        level2 = self.down2(self.pool1(level1))
        middle = self.middle(self.pool2(level2))
        up2 = self.up2(torch.cat((functional.pixel_shuffle(self.expand2(middle), 2), level2), 1))
        up1 = self.up1(torch.cat((functional.pixel_shuffle(self.expand1(up2), 2), level1), 1))
        return up1, middle.mean((-2, -1))


class Decoder(nn.Module):
    """Decoder from features (n, width, 32, 32) to images (n, outputs, 64, 64)."""

    def __init__(self, width: int, outputs: int) -> None:
        super().__init__()
        self.expand = nn.Conv2d(width, 2 * width, 1)
        self.fine = ResidualBlock(width // 2, width // 2)
        self.draw = nn.Sequential(nn.GroupNorm(GROUPS, width // 2), nn.SiLU(), nn.Conv2d(width // 2, outputs, 3, padding=1))

    def forward(self, level: torch.Tensor) -> torch.Tensor:
        return self.draw(self.fine(functional.pixel_shuffle(self.expand(level), 2))).float()
