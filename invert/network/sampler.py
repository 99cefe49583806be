"""The diffusion posterior sampler: denoises an image of the object at a known noise level, given the autocorrelation estimate.

A diffusion model conditioned on the estimate, preconditioned as by Karras et al. (NeurIPS 2022, arXiv:2206.00364). The noise in the
image breaks the symmetry between the object and its twin image; a network with the estimate as its only input blends both.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from invert.network.blocks import Decoder, Unet, autocast
from invert.network.features import SKETCH_CHANNELS, Observation, sketch_features

ALBEDO_STD = 0.25
"""Approximate standard deviation of albedos (sigma_data in Karras et al.)."""

_MAPS = 4
"""Images in the input: noisy image, previous estimate, significance of the gradient, step."""

_MIN_INFORMATION = 4.0
"""Fisher information of a pixel below which the step in the input is shortened; it corresponds to an error of half the
maximum albedo."""


def posterior_variance(sigma: torch.Tensor) -> torch.Tensor:
    """Return the posterior variance of an albedo under white noise of standard deviation sigma, if both were Gaussian."""
    return (sigma * ALBEDO_STD).square() / (sigma.square() + ALBEDO_STD**2)


class Sampler(nn.Module):
    """Denoising network of the posterior sampler: it predicts the albedo from a noisy image, the noise level and the estimate."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.unet, self.drawing = Unet(SKETCH_CHANNELS + 4 * _MAPS + 1, width), Decoder(width, 1)

    def forward(self, seen: Observation, noisy: torch.Tensor, sigma: torch.Tensor, guess: torch.Tensor) -> torch.Tensor:
        """Denoise albedos; return (n, 64, 64).

        Args:
            seen: one observation per albedo, or one of all.
            noisy: albedos (n, 64, 64) with white noise of standard deviation sigma (n,).
            guess: previous estimate of the albedos (self-conditioning input), (n, 64, 64), registered; zeros without one.
        """
        with torch.no_grad():
            at = seen.likelihood().at(guess)
            gradient, information = at.gradient(), at.information()
        significance, step = gradient / information.sqrt(), (gradient / (information + _MIN_INFORMATION)).clamp(-2.0, 2.0)
        spread = sigma[:, None, None]
        shrink = (spread.square() + ALBEDO_STD**2).rsqrt()
        maps = torch.stack((shrink * noisy, guess, torch.asinh(significance) / 3.0, step), 1)
        cells = functional.pixel_unshuffle(maps, 2)
        level = (sigma.log() / 4.0)[:, None, None, None].expand(-1, 1, *cells.shape[-2:])
        features = sketch_features(seen).expand(len(cells), -1, -1, -1)
        shown = torch.cat((cells, features, level), 1)
        with autocast(shown.device):
            drawn = self.drawing(self.unet(shown.to(memory_format=torch.channels_last))[0])[:, 0]
        return ALBEDO_STD**2 * shrink.square() * noisy + spread * ALBEDO_STD * shrink * drawn
