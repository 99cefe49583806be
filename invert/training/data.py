"""Training batches: targets with independent noise, determined by the seed and the step alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch.nn import functional

from correlograph.lags import lag_grid, lag_grid_of
from invert.albedo.registration import normalise_peak
from invert.network.features import Observation
from invert.training.denoising import Draws, shift_randomly
from radiometry.noise.measured_noise import outermost_signal_ring
from radiometry.noise.model import autocorrelate_windowed, draw_estimate

EMPTY_SHARE = 0.04
"""Fraction of samples with noise only, from which the network learns low confidence."""

GREY_SHARE = 0.3
"""Fraction of samples whose albedo varies over the object."""

CORRELATED_SHARE = 0.7
"""Fraction of samples with the correlated noise of whole frames; the rest have that of non-overlapping patches."""


@lru_cache(maxsize=8)
def _radius_squared(lags: int) -> torch.Tensor:
    """Return the squared distance of every lag from zero, 1 at the largest lag of a row or column; (127, 127)."""
    grid = lag_grid(lags)
    return torch.from_numpy(np.hypot(grid.row, grid.column).astype(np.float32) / lags).square()


@dataclass(frozen=True)
class Batch:
    """Observations with their noise levels, truths (n, 64, 64), their signals without floor and noise (n, 127, 127), and the
    random numbers of the sampler's task.

    A truth of zeros stands for an estimate without signal.
    """

    seen: Observation
    truth: torch.Tensor
    signal: torch.Tensor
    draws: Draws | None = None

    def part(self, which: slice, device: str | torch.device) -> Batch:
        draws = None if self.draws is None else self.draws.part(which, device)
        return Batch(self.seen.part(which, device), self.truth[which].to(device), self.signal[which].to(device), draws)


def at_noise(truth: torch.Tensor, floor: torch.Tensor | float, dof: torch.Tensor | float, rng: torch.Generator) -> Batch:
    """Return estimates of truths at a noise level, b in units of the maximum lag except zero (Metzler et al. 2020 use 1/255)."""
    n = len(truth)
    floor = torch.as_tensor(floor).expand(n).float()
    dof = torch.as_tensor(dof).expand(n).float()
    signal = _signal(truth)
    estimate = draw_estimate(signal + floor[:, None, None], dof, rng)
    return Batch(Observation.from_estimate(estimate, floor, dof), truth, signal)


def make_varied_batch(targets: torch.Tensor, count: int, rng: torch.Generator) -> Batch:
    """Return random targets (uint8 pool (N, 64, 64)), flipped and transposed, at noise of every level and of several kinds."""

    def chance(share: float) -> torch.Tensor:
        return (torch.rand(count, generator=rng) < share)[:, None, None]

    def uniform(low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(count, generator=rng)

    truth = targets[torch.randint(len(targets), (count,), generator=rng)].float() / 255.0
    truth = torch.where(chance(0.5), truth.mT, truth)
    truth = torch.where(chance(0.5), truth.flip(-1), truth)
    truth = torch.where(chance(0.5), truth.flip(-2), truth)
    truth = torch.where(chance(0.25), functional.max_pool2d(truth, 3, 1, 1), truth)  # thicker lines
    truth = torch.where(chance(GREY_SHARE), apply_shading(truth, rng), truth)
    truth = torch.where(chance(EMPTY_SHARE), torch.zeros(()), truth)
    floor = torch.exp(uniform(np.log(0.005), np.log(4.0)))
    dof = torch.exp(uniform(np.log(8.0), np.log(1e4)))
    dof = torch.where(chance(0.1)[:, 0, 0], torch.exp(uniform(np.log(1e4), np.log(1e6))), dof)
    # transfer of an unknown camera, and a sloping background
    signal = _signal(truth)
    grid, lags = lag_grid_of(signal), lag_grid_of(signal).lags
    radius_squared = _radius_squared(lags)
    signal = signal * torch.exp(-radius_squared * (uniform(0.0, 2.0)[:, None, None] * chance(0.5)))
    slope = uniform(-0.15, 0.15)[:, None, None] * chance(0.15)
    spectrum = signal + floor[:, None, None] * (1.0 + slope * (radius_squared - 0.7))
    apart = draw_estimate(spectrum, dof, rng)
    estimate = torch.where(chance(CORRELATED_SHARE), draw_estimate(spectrum, dof, rng, correlated=True), apart)
    # Read noise of sensor lines fills the row or column through zero lag; significant lines are interpolated.
    for row, interpolated, weak in ((True, 0.3, 0.15), (False, 0.1, 0.1)):
        view = estimate if row else estimate.mT
        line = view[:, lags]
        beside = 0.5 * (view[:, lags - 1] + view[:, lags + 1])
        excess = (uniform(0.0, 0.2) * floor)[:, None] * torch.rand(count, grid.side, generator=rng).add(0.5)
        excess = excess + excess.flip(-1)
        line = torch.where(chance(weak)[:, 0], line + 0.5 * excess, line)
        view[:, lags] = torch.where(chance(interpolated)[:, 0], beside, line)
    read_from = int((grid.ring > outermost_signal_ring(grid)).sum()) // 2
    read_error = torch.randn(2, count, generator=rng)
    read_floor, read_dof = floor * (1.0 + read_error[0] * (dof * read_from).rsqrt()), dof * (1.0 + 0.04 * read_error[1])
    return Batch(Observation.from_estimate(estimate, read_floor, read_dof), truth, signal)


def apply_shading(truth: torch.Tensor, rng: torch.Generator) -> torch.Tensor:
    """Multiply albedos (n, 64, 64) by a random field, about 0.1 to 1; maximum 1 each.

    Its amplitude falls with spatial frequency by a power between 1, as in photographs (D. J. Field, J. Opt. Soc. Am. A 4, 2379, 1987,
    doi:10.1364/JOSAA.4.002379), and 3, which is smooth.
    """
    side = truth.shape[-1]
    frequency = side * torch.hypot(torch.fft.fftfreq(side)[:, None], torch.fft.rfftfreq(side))
    power = 1.0 + 2.0 * torch.rand(len(truth), 1, 1, generator=rng)
    white = torch.fft.rfft2(torch.randn(truth.shape, generator=rng))
    field = torch.fft.irfft2(white * frequency.clamp_min(1.0) ** -power, s=truth.shape[-2:])
    return normalise_peak(truth * (0.1 + torch.sigmoid(2.0 * field / field.std((-2, -1), keepdim=True))))


def hidden_in_noise(batch: Batch, rng: torch.Generator) -> Batch:
    """Return the batch of the sampler's task: objects near the centre, with the random numbers of their noise."""
    return replace(batch, truth=shift_randomly(batch.truth, rng), draws=Draws.of(len(batch.truth), batch.truth.shape[-1], rng))


def warm(stored: dict[str, torch.Tensor], count: int, rng: torch.Generator) -> Batch:
    """Return random precomputed estimates, denoised, with their classical reconstructions (see
    `invert.training.warm_starts`), flipped and transposed."""
    chosen = torch.randint(len(stored["albedo"]), (count,), generator=rng)
    pictures = [
        stored[name][chosen].float() * scale
        for name, scale in (("estimate", 1.0), ("denoised", 1.0), ("albedo", 1.0 / 255.0), ("classical", 1.0 / 255.0))
    ]
    for turn in (lambda x: x.mT, lambda x: x.flip(-1), lambda x: x.flip(-2)):
        turned = torch.rand(count, generator=rng) < 0.5
        pictures = [torch.where(turned.view(-1, *[1] * (picture.ndim - 1)), turn(picture), picture) for picture in pictures]
    estimate, denoised, truth, classical = pictures
    seen = Observation(estimate, *(stored[name][chosen] for name in ("floor", "dof")), denoised, classical)
    return Batch(seen, truth, _signal(truth))


def paper_noise(targets: torch.Tensor, count: int, rng: torch.Generator) -> Batch:
    """Return the training data of Metzler et al. 2020, section 5.A: b = 70 of 255 and gamma / N = 0.015 for every sample."""
    truth = targets[torch.randint(len(targets), (count,), generator=rng)].float() / 255.0
    return at_noise(truth, 70.0 / 255.0, 1.0 / 0.015, rng)


def _signal(truth: torch.Tensor) -> torch.Tensor:
    """Return H (r*r) smoothed by the patch window, maximum lag except zero 1; zero for an empty truth."""
    signal = autocorrelate_windowed(truth)
    lags = lag_grid_of(signal).lags
    beside = torch.maximum(signal[:, lags, lags + 1], signal[:, lags + 1, lags])
    return signal / beside.clamp_min(1e-12)[:, None, None]
