"""The forward model S = a H (r*r) + c p + b of an estimate and its derivatives, on half of the lags.

H is the transfer of the camera, r*r the autocorrelation of the albedo smoothed by the patch window, p a pedestal, and b the floor.
Opposite lags are equal, so arrays of lags hold rows 0 to 63 only: (n, 64, 128), zero lag at [0, 0], negative columns at the end.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch.nn import functional

from correlograph.lags import lag_grid, lag_grid_of
from radiometry.autocorrelation import window_kernel

PEDESTAL_SIGMA = 0.5
"""Standard deviation of the pedestal of an estimate in units of the window of the object. Lab estimates contain such
an excess, 1 to 4 % of the maximum lag, of unknown origin. A model without it favours smeared albedos."""


def zero_lag_first(lags: torch.Tensor) -> torch.Tensor:
    """Move lags (n, 127, 127) to the periodic grid (n, 128, 128), zero lag from the middle to [0, 0]."""
    middle = lag_grid_of(lags).lags
    return torch.roll(functional.pad(lags, (0, 1, 0, 1)), (-middle, -middle), (-2, -1))


def half_of(lags: torch.Tensor) -> torch.Tensor:
    """Return rows 0 to 63 of lags (n, 127, 127), (n, 64, 128)."""
    return zero_lag_first(lags)[..., : lag_grid_of(lags).object_side, :]


@lru_cache(maxsize=8)
def lags_used(lags: int) -> torch.Tensor:
    """Return a mask of the lags used, float64 (1, 64, 128): one of each pair of opposite lags, without zero lag and its
    neighbours, which carry little information.
    """
    grid = lag_grid(lags)
    return half_of(torch.from_numpy((grid.ring > 1) & grid.half_plane).double()[None])


@lru_cache(maxsize=8)
def pedestal_profile(lags: int) -> torch.Tensor:
    """Return the pedestal p, a wide excess that lab estimates contain, at every lag, float64 (1, 64, 128), 1 at zero lag."""
    grid = lag_grid(lags)
    profile = torch.exp(-0.5 * (torch.from_numpy(grid.steps).double() / (PEDESTAL_SIGMA * grid.object_side)).square())
    return half_of(torch.outer(profile, profile)[None])


@lru_cache(maxsize=8)
def _window_spectrum(lags: int, period: int) -> torch.Tensor:
    """Return the Fourier transform of the smoothing by the patch window on a periodic grid, float64 (period, period // 2 + 1)."""
    kernel = torch.from_numpy(window_kernel(lags, period // 2 - 1)[lags])
    response = torch.fft.fft(torch.roll(functional.pad(kernel, (0, 1)), -(period // 2 - 1))).real
    return torch.outer(response, response[: period // 2 + 1])


class ForwardModel:
    """H (r*r) of albedos and its derivatives.

    Args:
        exact: whether objects may reach the edge of the object window. Otherwise the smoothing by the patch window is periodic,
            which takes half of the time and changes r*r by up to 0.3 % of its maximum if an object fills the window.
        transfer: H per lag (127, 127); 1 if None.
        like: tensor of the device and the type of the computation.
    """

    def __init__(self, lags: int, like: torch.Tensor, *, exact: bool, transfer: np.ndarray | None = None) -> None:
        self._rows = lags + 1
        self._period = 3 * self._rows + self._rows % 2 if exact else 2 * self._rows
        self._window = _window_spectrum(lags, self._period).to(like)
        self._transfer = None if transfer is None else half_of(torch.from_numpy(transfer)[None]).to(like)

    def spectrum(self, albedo: torch.Tensor) -> torch.Tensor:
        """Return the Fourier transform of albedos (n, 64, 64)."""
        return self._forward(albedo)

    def signal(self, power: torch.Tensor) -> torch.Tensor:
        """Return the signal, the transfer H of the camera times r*r, (n, 64, 128), of a power spectrum |r|^2."""
        lags = self._inverse(power * self._window)
        if self._period > 2 * self._rows:
            lags = torch.cat((lags[..., : self._rows], lags[..., -self._rows :]), -1)
        return lags if self._transfer is None else lags * self._transfer

    def slope(self, lags: torch.Tensor, spectrum: torch.Tensor) -> torch.Tensor:
        """Return the derivative of sum(lags H (r*r)) with respect to each pixel, (n, 64, 64), at albedos with this `spectrum`.

        d (r*r)(lag) / d r(x) = r(x + lag) + r(x - lag).
        """
        if self._transfer is not None:
            lags = lags * self._transfer
        if self._period > 2 * self._rows:
            gap = lags.new_zeros((*lags.shape[:-1], self._period - 2 * self._rows))
            lags = torch.cat((lags[..., : self._rows], gap, lags[..., self._rows :]), -1)
        both = 2.0 * self._window * self._forward(lags).real
        return self._inverse(both * spectrum)[..., : self._rows]

    def _forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the Fourier transform of zero-padded arrays; the padded rows are not transformed along the rows."""
        return torch.fft.fft(torch.fft.rfft(rows, n=self._period), n=self._period, dim=-2)

    def _inverse(self, spectrum: torch.Tensor) -> torch.Tensor:
        """Return the first 64 rows of the inverse transform, (n, 64, period)."""
        return torch.fft.irfft(torch.fft.ifft(spectrum, dim=-2)[..., : self._rows, :], n=self._period)


@torch.no_grad()  # the likelihood is stationary at the fitted gains
def fit_gains(
    signal: torch.Tensor, pedestal: torch.Tensor, estimate: torch.Tensor, floor: torch.Tensor, weight: torch.Tensor, rounds: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Fit the gains a and c (n,) of object and pedestal by reweighted least squares, in which each lag has the weight
    `weight` / S^2, with the fitted mean S.

    Args:
        signal: H (r*r) of each object, (n, lags); the other arguments broadcast to this shape.
    """
    expected = torch.zeros_like(signal) + floor
    for _ in range(rounds):
        bright, faint = _least_squares_gains(signal, pedestal, estimate - floor, weight * expected.square().reciprocal())
        expected = floor + bright[:, None] * signal + faint[:, None] * pedestal
    return bright, faint


def _least_squares_gains(
    signal: torch.Tensor, pedestal: torch.Tensor, excess: torch.Tensor, weight: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return gains a, c (n,), zero or more, that fit a * signal (n, lags) + c * pedestal to an excess by weighted least
    squares."""
    limits = torch.finfo(signal.dtype)
    ss, pp = (weight * signal.square()).sum(1).clamp_min(limits.tiny), (weight * pedestal.square()).sum(1)
    sp, se, pe = ((weight * one * other).sum(1) for one, other in ((signal, pedestal), (signal, excess), (pedestal, excess)))
    faint = (pe - sp * (se / ss)) / (pp - sp * (sp / ss)).clamp_min(16.0 * limits.eps * pp)
    # if the best signal would be negative, the pedestal is fitted alone
    faint = torch.minimum(faint, pe / pp).clamp_min(0.0)
    return ((se - sp * faint) / ss).clamp_min(0.0), faint
