"""What the networks see of an estimate: the signal, its significance, and the noise level."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch.nn import functional

from invert.registration import OBJECT
from radiometry.autocorrelation import LAGS

CHANNELS = 2 * (16 + 4) + 2
"""All lags four by four, the inner ones (as far as the albedo reaches) two by two, for two pictures; two numbers."""

DOF_RANGE = (1.0, 1e6)


@dataclass(frozen=True)
class Observation:
    """What is known of each of n objects.

    Attributes:
        estimate: (n, 127, 127), zero lag at [63, 63], floor included.
        floor, dof: noise level of each, (n,).
        classical: what classical retrieval makes of it, (n, 2, 64, 64), largest value 1 each: the mean of the best starts,
            and the start of least residual, laid over it; zeros where it was not tried.
    """

    estimate: torch.Tensor
    floor: torch.Tensor
    dof: torch.Tensor
    classical: torch.Tensor

    @classmethod
    def alone(cls, estimate: torch.Tensor, floor: torch.Tensor, dof: torch.Tensor) -> Observation:
        """Estimates without a classical reconstruction."""
        return cls(estimate, floor, dof, estimate.new_zeros(len(estimate), 2, OBJECT, OBJECT))

    def __len__(self) -> int:
        return len(self.estimate)

    def part(self, which: slice, device: str) -> Observation:
        """Some of the objects, on a device."""
        return Observation(*(getattr(self, field.name)[which].to(device) for field in fields(self)))


def features(seen: Observation) -> torch.Tensor:
    """Features of observations, free of the estimate's unit; zero lag is never looked at.

    Returns:
        (n, CHANNELS, 32, 32): the signal over its height near zero lag, under a square root; the signal over its
        own noise, logarithmic where large; floor over height and K, logarithmic.
    """
    floor = seen.floor
    freedom = seen.dof.clamp(*DOF_RANGE)[:, None, None]
    filled = _without_zero_lag(seen.estimate)
    signal = filled - floor[:, None, None]
    near = signal[:, LAGS - 1 : LAGS + 2, LAGS - 1 : LAGS + 2].mean((-2, -1))
    # Where there is no signal its height is a few times its error.
    height = torch.maximum(near, 3.0 * floor * (freedom[:, 0, 0] * 4.0).rsqrt()).clamp_min(1e-30)[:, None, None]
    relative = signal / height
    root = relative.sign() * relative.abs().sqrt()
    significance = torch.asinh(signal * freedom.sqrt() / filled.clamp_min(1e-3 * height)) / 3.0
    pictures = functional.pad(torch.stack((root, significance), 1), (1, 0, 1, 0))
    inner = pictures[:, :, 32:96, 32:96]
    numbers = torch.stack((torch.log10(floor / height[:, 0, 0] + 1e-3), 0.5 * torch.log10(freedom[:, 0, 0]) - 1.0), 1)
    planes = numbers[:, :, None, None].expand(-1, -1, 32, 32)
    return torch.cat((functional.pixel_unshuffle(pictures, 4), functional.pixel_unshuffle(inner, 2), planes), 1)


def paper_picture(estimate: torch.Tensor) -> torch.Tensor:
    """The paper's input: the estimate over its largest lag but zero, (n, 1, 128, 128)."""
    filled = _without_zero_lag(estimate)
    return functional.pad(filled / filled.amax((-2, -1), keepdim=True).clamp_min(1e-30), (1, 0, 1, 0))[:, None]


def modulus_picture(estimate: torch.Tensor, floor: torch.Tensor) -> torch.Tensor:
    """|F(r)| from the estimate less its floor, zero frequency in the middle, largest value 1; (n, 1, 128, 128)."""
    excess = functional.pad(_without_zero_lag(estimate) - floor[:, None, None], (0, 1, 0, 1))
    spectrum = torch.fft.fft2(torch.roll(excess, (-LAGS, -LAGS), (-2, -1))).real.clamp_min(0.0).sqrt()
    return torch.fft.fftshift(spectrum / spectrum.amax((-2, -1), keepdim=True).clamp_min(1e-30), (-2, -1))[:, None]


def _without_zero_lag(estimate: torch.Tensor) -> torch.Tensor:
    """Zero lag replaced by the mean of its four neighbours."""
    filled = estimate.clone()
    filled[:, LAGS, LAGS] = 0.5 * (estimate[:, LAGS, LAGS + 1] + estimate[:, LAGS + 1, LAGS])
    return filled
