"""Input features of the networks: signal, significance of each lag, noise level, classical reconstructions."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch.nn import functional

from correlograph.lags import lag_grid_of
from invert.likelihood.forward_model import zero_lag_first
from invert.likelihood.gamma import Likelihood

LAG_CHANNELS = 2 * 2 * 4 + 2 + 2
"""Channels: two maps and their mirror images, 4 for each (blocks of 2 x 2 lags); two numbers; two coordinates."""

SKETCH_CHANNELS, FUSION_CHANNELS = (maps * (16 + 4) + 2 for maps in (2, 3))
"""Channels: per map, 4 x 4 blocks of all lags and 2 x 2 blocks of the inner lags (as many as albedo pixels); two numbers."""

PICTURES = 4
"""Number of classical reconstructions in the input of the fusion."""

DOF_RANGE = (1.0, 1e6)
"""Range to which K is limited; the training data contain 8 to 10^6."""


@dataclass(frozen=True)
class Observation:
    """Observation of n objects, the conditioning input of the networks.

    Attributes:
        values: estimates (n, 127, 127), zero lag at [63, 63], floor included.
        floor, dof: noise level of each, (n,).
        denoised: output of the denoiser, the signal without floor and noise, (n, 127, 127); zeros before denoising.
        classical: classical reconstructions from the estimate and from its denoised signal, (n, PICTURES, 64, 64), maximum 1 each:
            from each, the mean of the best starts and the start with the lowest residual; zeros before retrieval.
    """

    values: torch.Tensor
    floor: torch.Tensor
    dof: torch.Tensor
    denoised: torch.Tensor
    classical: torch.Tensor

    @classmethod
    def from_estimate(cls, estimate: torch.Tensor, floor: torch.Tensor, dof: torch.Tensor) -> Observation:
        """Return observations of estimates alone; the other inputs are zero."""
        side = lag_grid_of(estimate).object_side
        pictures = estimate.new_zeros(len(estimate), PICTURES, side, side)
        return cls(estimate, floor, dof, torch.zeros_like(estimate), pictures)

    def __len__(self) -> int:
        return len(self.values)

    def likelihood(self) -> Likelihood:
        """Return the likelihood of the estimates."""
        return Likelihood(self.values, self.floor, self.dof.clamp(*DOF_RANGE))

    def part(self, which: slice, device: str | torch.device) -> Observation:
        """Return some of the objects on a device."""
        return Observation(*(getattr(self, field.name)[which].to(device) for field in fields(self)))


def _normalise_features(seen: Observation) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return dimensionless maps, zero lag replaced by the mean of its neighbours.

    These are the signal in units of its height near zero lag (n, 127, 127); the signal in units of its noise, logarithmic if large;
    floor over height and K, logarithmic (n, 2); and the height (n,).
    """
    floor, freedom = seen.floor, seen.dof.clamp(*DOF_RANGE)
    filled = fill_zero_lag_by_neighbours(seen.values)
    signal = filled - floor[:, None, None]
    near = mean_near_zero_lag(signal)
    # without signal the height is a few times its error
    height = torch.maximum(near, 3.0 * floor * (freedom * 4.0).rsqrt()).clamp_min(1e-30)
    scale = height[:, None, None]
    significance = torch.asinh(signal * freedom.sqrt()[:, None, None] / filled.clamp_min(1e-3 * scale)) / 3.0
    numbers = torch.stack((torch.log10((floor / height).clamp_min(0.0) + 1e-3), 0.5 * torch.log10(freedom) - 1.0), 1)
    return signal / scale, significance, numbers, height


def _root(picture: torch.Tensor) -> torch.Tensor:
    return picture.sign() * picture.abs().sqrt()


def lag_features(seen: Observation) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the input of the denoiser.

    Returns:
        (n, LAG_CHANNELS, 64, 32): the half plane of column lags h = 0 to 63, with the channels of lag (-v, h) next to those of
        (v, h), so that neighbours on both sides of the line h = 0, at which the plane is cut, are close as well;
        the signal in units of its height (n, 127, 127); that height (n,).
    """
    relative, significance, numbers, height = _normalise_features(seen)
    maps = half_plane(torch.stack((_root(relative), significance), 1))
    both = functional.pixel_unshuffle(torch.cat((maps, _negate_row_lags(maps)), 1), 2)
    planes = numbers[:, :, None, None].expand(-1, -1, *both.shape[-2:])
    row, column = (
        torch.linspace(low, 1.0, size, device=both.device) for low, size in zip((-1.0, 0.0), both.shape[-2:], strict=True)
    )
    places = torch.stack(torch.meshgrid(row, column, indexing="ij")).expand(len(both), -1, -1, -1)
    return torch.cat((both, planes, places), 1), relative, height


def sketch_features(seen: Observation) -> torch.Tensor:
    """Return the input of the sketch, (n, SKETCH_CHANNELS, 32, 32)."""
    relative, significance, numbers, _ = _normalise_features(seen)
    return _stack_cells(torch.stack((_root(relative), significance), 1), numbers)


def picture_features(seen: Observation) -> torch.Tensor:
    """Return the input of the fusion without images, (n, FUSION_CHANNELS, 32, 32): that of the sketch, and the denoised
    signal."""
    relative, significance, numbers, height = _normalise_features(seen)
    return _stack_cells(torch.stack((_root(relative), significance, _root(seen.denoised / height[:, None, None])), 1), numbers)


def _stack_cells(maps: torch.Tensor, numbers: torch.Tensor) -> torch.Tensor:
    """Stack maps (n, m, 127, 127) and numbers (n, k) as channels of 32 x 32 cells."""
    side = lag_grid_of(maps).object_side
    maps = functional.pad(maps, (1, 0, 1, 0))
    planes = numbers[:, :, None, None].expand(-1, -1, side // 2, side // 2)
    inner = maps[:, :, side // 2 : 3 * side // 2, side // 2 : 3 * side // 2]
    return torch.cat((functional.pixel_unshuffle(maps, 4), functional.pixel_unshuffle(inner, 2), planes), 1)


def half_plane(lags: torch.Tensor) -> torch.Tensor:
    """Return the lags (..., 127, 127) with non-negative column, (..., 128, 64); the first row is empty, zero lag at [64, 0]."""
    return functional.pad(lags[..., lag_grid_of(lags).lags :], (0, 0, 1, 0))


def whole_plane(half: torch.Tensor) -> torch.Tensor:
    """Return the centro-symmetric lags (..., 127, 127) of a half plane (..., 128, 64), whose column zero holds each lag twice."""
    turned = _negate_row_lags(half)
    middle = 0.5 * (half + turned)[..., :1]
    return torch.cat((turned[..., 1:].flip(-1), middle, half[..., 1:]), -1)[..., 1:, :]


def _negate_row_lags(half: torch.Tensor) -> torch.Tensor:
    """Negate the row lags of a half plane."""
    return functional.pad(half[..., 1:, :].flip(-2), (0, 0, 1, 0))


def paper_picture(estimate: torch.Tensor) -> torch.Tensor:
    """Return the input of Metzler et al. 2020: the estimate in units of its maximum except zero lag, (n, 1, 128, 128)."""
    filled = fill_zero_lag_by_neighbours(estimate)
    return functional.pad(filled / filled.amax((-2, -1), keepdim=True).clamp_min(1e-30), (1, 0, 1, 0))[:, None]


def modulus_picture(estimate: torch.Tensor, floor: torch.Tensor) -> torch.Tensor:
    """Return |F(r)| from the estimate minus its floor, zero frequency in the middle, maximum 1; (n, 1, 128, 128)."""
    excess = fill_zero_lag_by_neighbours(estimate) - floor[:, None, None]
    spectrum = torch.fft.fft2(zero_lag_first(excess)).real.clamp_min(0.0).sqrt()
    return torch.fft.fftshift(spectrum / spectrum.amax((-2, -1), keepdim=True).clamp_min(1e-30), (-2, -1))[:, None]


def fill_zero_lag_by_neighbours(estimate: torch.Tensor) -> torch.Tensor:
    """Replace zero lag by the mean of its four neighbours."""
    filled, middle = estimate.clone(), lag_grid_of(estimate).lags
    filled[:, middle, middle] = 0.5 * (estimate[:, middle, middle + 1] + estimate[:, middle + 1, middle])
    return filled


def mean_near_zero_lag(lags: torch.Tensor) -> torch.Tensor:
    """Return the mean (n,) of the nine lags around zero lag, for lags (n, 127, 127) with zero lag filled."""
    middle = lag_grid_of(lags).lags
    return lags[:, middle - 1 : middle + 2, middle - 1 : middle + 2].mean((-2, -1))
