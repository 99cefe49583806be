"""Prior of the field: E_j ~ CN(0, r_j), independent, where r is the albedo times the illumination.

The first prior is the coarse albedo, interpolated to the cells. Expectation maximisation then replaces it by the despeckled |E|^2 of
the frames (Dempster, Laird, Rubin, doi:10.1111/j.2517-6161.1977.tb01600.x).
"""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage

from invert.field.grid import FieldGrid
from radiometry.field_forecast import MIN_ALBEDO

FLOORS = (0.03, 0.001)
"""Minimum of a later prior as a fraction of its maximum. The higher floor lets parts appear that the coarse albedo lacks, the lower one
suppresses noise; the held-out pixels decide."""

SMOOTHING_CELLS = 0.5
"""Standard deviation, in cells, of the Gaussian that smooths the albedo for the next prior."""


def prior_from_albedo(albedo: np.ndarray, grid: FieldGrid) -> torch.Tensor:
    """Return the coarse albedo, interpolated to the cells of the box; zero where it is dark."""
    positions = np.meshgrid(*grid.lag_positions(), indexing="ij")
    fine = ndimage.map_coordinates(albedo.astype(np.float64), positions, order=3, mode="constant")
    fine[fine < MIN_ALBEDO * fine.max()] = 0.0
    return torch.from_numpy(fine.astype(np.float32))


def priors_from_albedo(albedo: torch.Tensor) -> list[torch.Tensor]:
    """Return the candidates for the next prior, one for each of `FLOORS`, from the despeckled albedo on the cells of the box."""
    smooth = torch.from_numpy(ndimage.gaussian_filter(albedo.numpy(), SMOOTHING_CELLS, mode="constant"))
    return [smooth.clamp_min(floor * float(smooth.max())) for floor in FLOORS]


def scale_to_signal(prior: torch.Tensor, signal: float, grid: FieldGrid) -> torch.Tensor:
    """Scale a prior so that the expected signal of a binned pixel is `signal` counts."""
    pixels = grid.shape[0] * grid.shape[1]
    return prior * (signal * pixels / float(prior.sum(dtype=torch.float64)))
