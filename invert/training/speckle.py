"""Training data of the despeckler: mean intensities of a few speckled fields on cells of the diffraction limit of a frame.

A field is the product of the square root of the albedo, the speckle field of the illumination and white scatter, all on half cells, seen
through the window of a frame. Part of the intensities are those that retrieval from few photons leaves: with noise n and a prior p,
the posterior mean of the field is p / (p + n) times the noisy field, and the posterior variance p n / (p + n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch.nn import functional

from invert.training.data import apply_shading

SIDE = 96
"""Side of a training image in cells."""

FINE = 2
"""Points per cell along each axis at which scatter is drawn."""

MAX_LOOKS = 12
"""Maximum number of looks; the contrast of more hardly differs."""

ZOOM = (1.0, 10.0)
"""Cells per pixel of a target."""

ASPECT = 1.4
"""Maximum ratio of the zooms along the two axes."""

SHARP_SHARE, SHADED_SHARE, RETRIEVED_SHARE, LIT_SHARE = 0.6, 0.3, 0.6, 0.7
"""Fractions of the images: edges as sharp as a cell; shaded; noise of retrieval; illuminated by speckle."""

GRATING_SHARE = 0.08
"""Fraction of the images whose objects are filled with bars."""

GRATING_PERIOD = (2.4, 24.0)
"""Period of the bars in cells."""

GRAIN = (1.0, 3.0)
"""Grain of the illumination in cells."""

PHOTONS = (0.5, 100.0)
"""Signal over noise of a cell in units of the mean albedo, if a field has the noise of retrieval."""

LEVELS = ((1, 100.0), (2, 4.0), (2, 100.0), (8, 100.0))
"""Numbers of looks and signals over noise at which progress is measured."""


@dataclass(frozen=True)
class Speckled:
    """Mean intensities (n, side, side) of a number of looks (n,), and the albedos behind them in the same unit."""

    intensity: torch.Tensor
    looks: torch.Tensor
    truth: torch.Tensor

    def part(self, which: slice, device: str | torch.device) -> Speckled:
        return Speckled(*(one[which].to(device) for one in (self.intensity, self.looks, self.truth)))


def draw_speckled(targets: torch.Tensor, count: int, rng: torch.Generator) -> Speckled:
    """Return random targets (uint8 pool (N, side, side)), turned, cropped and zoomed, with speckle of every kind."""
    looks = round(math.exp(float(torch.rand(1, generator=rng)) * math.log(MAX_LOOKS + 0.5)))
    photons = _spread(count, PHOTONS, rng)
    exact = torch.rand(count, generator=rng) >= RETRIEVED_SHARE
    return _speckle(_draw_albedos(targets, count, rng), looks, torch.where(exact, torch.inf, photons), rng)


def speckled_at(targets: torch.Tensor, count: int, looks: int, photons: float, rng: torch.Generator) -> Speckled:
    """Return the same at one number of looks and one signal over noise."""
    return _speckle(_draw_albedos(targets, count, rng), looks, torch.full((count,), photons), rng)


def _draw_albedos(targets: torch.Tensor, count: int, rng: torch.Generator) -> torch.Tensor:
    """Return albedos (count, FINE SIDE, FINE SIDE), maximum 1."""
    chosen = targets[torch.randint(len(targets), (count,), generator=rng)].float()[:, None] / 255.0
    side = chosen.shape[-1]
    angle = 2.0 * math.pi * torch.rand(count, generator=rng)
    zoom, aspect = _spread(count, ZOOM, rng), _spread(count, (ASPECT**-0.5, ASPECT**0.5), rng)
    reach = SIDE / side / zoom  # half of the crop in units of half of the target
    mirror = 1.0 - 2.0 * (torch.rand(count, generator=rng) < 0.5).float()
    turn = torch.stack((angle.cos(), -angle.sin(), angle.sin(), angle.cos()), 1).reshape(-1, 2, 2)
    turn = turn * (reach[:, None] * torch.stack((aspect * mirror, 1.0 / aspect), 1))[:, None]
    # the middle of the crop lies on the object
    weights = functional.avg_pool2d(chosen[:, 0], 4).flatten(1) + 1e-3
    middle = torch.multinomial(weights, 1, generator=rng)[:, 0]
    coarse = side // 4
    place = torch.stack((middle % coarse, middle // coarse), 1)
    place = (place + torch.rand(count, 2, generator=rng)) * (2.0 / coarse) - 1.0
    grid = functional.affine_grid(
        torch.cat((turn, place[:, :, None]), 2), [count, 1, FINE * SIDE, FINE * SIDE], align_corners=False
    )
    albedo = functional.grid_sample(chosen, grid, "bicubic", "zeros", align_corners=False)[:, 0].clamp(0.0, 1.0)
    sharp = torch.rand(count, generator=rng) < SHARP_SHARE
    top = albedo.amax((-2, -1), keepdim=True).clamp_min(0.05)
    steep = top * torch.sigmoid((albedo - 0.5 * top) * (8.0 + 4.0 * zoom)[:, None, None] / top)
    albedo = torch.where(sharp[:, None, None], (steep - 0.02 * top).clamp_min(0.0), albedo)
    barred = torch.rand(count, generator=rng) < GRATING_SHARE
    albedo = torch.where(barred[:, None, None], albedo * _draw_bars(count, rng), albedo)
    shaded = torch.rand(count, generator=rng) < SHADED_SHARE
    return torch.where(shaded[:, None, None], apply_shading(albedo, rng), albedo)


def _draw_bars(count: int, rng: torch.Generator) -> torch.Tensor:
    """Return gratings of bars (count, FINE SIDE, FINE SIDE), 0 to 1, of any direction, period and width; edges as sharp as a cell."""
    place = torch.arange(FINE * SIDE) / FINE
    angle, offset = 2.0 * math.pi * torch.rand(2, count, 1, 1, generator=rng)
    frequency = 2.0 * math.pi / _spread(count, GRATING_PERIOD, rng)[:, None, None]
    wave = torch.sin(frequency * (angle.cos() * place[:, None] + angle.sin() * place) + offset)
    level = torch.rand(count, 1, 1, generator=rng) - 0.5
    return torch.sigmoid((wave - level) * 8.0 / frequency)


def _speckle(albedo: torch.Tensor, looks: int, photons: torch.Tensor, rng: torch.Generator) -> Speckled:
    count = len(albedo)
    truth = functional.avg_pool2d(albedo, FINE)
    kept = 2 * round(0.5 * SIDE * (0.85 + 0.15 * float(torch.rand(1, generator=rng))))
    lit = torch.rand(count, generator=rng) < LIT_SHARE
    frequency = torch.fft.fftfreq(FINE * SIDE, 1.0 / FINE).abs()
    edge = 0.5 / _spread(count, GRAIN, rng)
    band = (frequency < edge[:, None]).float()
    band = band[:, :, None] * band[:, None]
    noise = (truth.mean((-2, -1)) / photons)[:, None, None]
    prior = _smooth_with_floor(truth, float(10.0 * torch.rand(1, generator=rng) ** 2), rng)
    share = prior / (prior + noise)
    total = torch.zeros_like(truth)
    for _ in range(looks):
        light = torch.fft.ifft2(torch.fft.fft2(_complex_normal(albedo.shape, rng)) * band)
        light = light / light.abs().square().mean((-2, -1), keepdim=True).sqrt()
        light = torch.where(lit[:, None, None], light, torch.ones((), dtype=light.dtype))
        field = _through_window(albedo.sqrt() * light * _complex_normal(albedo.shape, rng), kept)
        field = share * (field + noise.sqrt() * _complex_normal(field.shape, rng))
        total += (field.abs().square() + share * noise) / looks
    fitted = (total * truth).sum((-2, -1)) / truth.square().sum((-2, -1)).clamp_min(1e-12)
    return Speckled(total, torch.full((count,), float(looks)), truth * fitted[:, None, None])


def _through_window(field: torch.Tensor, kept: int) -> torch.Tensor:
    """Return fields on cells, with the `kept` x `kept` lowest frequencies of those on half cells."""
    transform = torch.fft.fftshift(torch.fft.fft2(field, norm="ortho"), (-2, -1))
    middle, half = transform.shape[-1] // 2, kept // 2
    seen = transform.new_zeros(*field.shape[:-2], SIDE, SIDE)
    inner = slice(SIDE // 2 - half, SIDE // 2 + half)
    seen[..., inner, inner] = transform[..., middle - half : middle + half, middle - half : middle + half]
    return torch.fft.ifft2(torch.fft.ifftshift(seen, (-2, -1)), norm="ortho")


def _smooth_with_floor(image: torch.Tensor, sigma: float, rng: torch.Generator) -> torch.Tensor:
    """Return images (n, side, side) smoothed by a Gaussian, with a floor."""
    frequency = torch.fft.fftfreq(image.shape[-1])
    kernel = torch.exp(-2.0 * (math.pi * sigma) ** 2 * (frequency[:, None] ** 2 + frequency[None] ** 2))
    smooth = torch.fft.ifft2(torch.fft.fft2(image) * kernel).real.clamp_min(0.0)
    floor = _spread(len(image), (1e-3, 3e-2), rng)[:, None, None]
    return torch.maximum(smooth, floor * smooth.amax((-2, -1), keepdim=True).clamp_min(1e-6))


def _complex_normal(shape: torch.Size, rng: torch.Generator) -> torch.Tensor:
    return torch.randn(shape, dtype=torch.complex64, generator=rng)


def _spread(count: int, limits: tuple[float, float], rng: torch.Generator) -> torch.Tensor:
    """Return random numbers (count,) between limits, uniform in the logarithm."""
    low, high = (math.log(limit) for limit in limits)
    return (low + (high - low) * torch.rand(count, generator=rng)).exp()
