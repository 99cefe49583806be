"""Derivatives of the expected frames: light budget, mean and expected autocorrelation as differentiable torch functions.

The object is flat and rough with a given albedo; its pose and the distances are parameters; light and camera are those of a scene.
The expected autocorrelation is H (r*r) under the patch window. Here r is the light of each cell of the object, at the position
where the frame centre sees it. It is smooth in every parameter, so that autograd gives its gradient (Metzler et al. 2020, Eqs. 5
to 8, in expectation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from scipy.constants import Planck, speed_of_light

from correlograph.lags import LAGS

Tensor = torch.Tensor


@dataclass(frozen=True)
class Setup:
    """Input of the expectation; float64 scalars with or without gradient.

    Attributes:
        albedo: power reflectance of the object's cells (n, n), rows down.
        cell_m: side of a cell on the object's surface.
        tilt_right, tilt_down: rotations of the object about the frame's column axis and about its row axis, radians.
        shift_right_m, shift_down_m: displacement of the object's centre across the line of sight.
        source_m, detector_m: distances from the object's centre to the spot and to the frame centre.
        source_angle: angle between spot and line of sight, about the column axis, radians; positive to the right.
        exposure_s, power_w, wavelength_m, pixel_pitch_m, pupil_diameter_m, pupil_m: laser and camera.
        losses: product of the albedos of both walls, their cosines, transmission and quantum efficiency.
        patch: pixels along the side of a patch.
        stretch: (rows, columns): ratio of `pixel_pitch_m` to the distance of neighbouring rows and columns as the object sees them.
    """

    albedo: Tensor
    cell_m: Tensor
    tilt_right: Tensor
    tilt_down: Tensor
    shift_right_m: Tensor
    shift_down_m: Tensor
    source_m: Tensor
    detector_m: Tensor
    source_angle: Tensor
    exposure_s: Tensor
    power_w: Tensor
    wavelength_m: Tensor
    pixel_pitch_m: Tensor
    pupil_diameter_m: Tensor
    pupil_m: Tensor
    losses: Tensor
    patch: int
    stretch: tuple[float, float] = (1.0, 1.0)

    def with_(self, **values: Any) -> Setup:
        """Return a copy with other values; numbers become float64 tensors."""
        return replace(self, **{name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()})


def setup_of(geometry: Any, cells: int = 48, patch: int | None = None) -> Setup:
    """Return the setup of a scene with a flat object that faces the wall; its albedo has `cells` cells along a side."""
    from radiometry.prediction import patches_of

    hidden, path, camera = geometry.hidden_object, geometry.light_path, geometry.camera.electronics
    extent = max(hidden.extent_m)
    albedo = hidden.cell_means((extent / cells, extent / cells), cells)
    to_spot = geometry.spot.centre - hidden.centre
    angle = math.atan2(float(to_spot @ hidden.axes.right), float(-to_spot @ hidden.line_of_sight))
    losses = (
        path.source_albedo
        * path.source_cosine
        * path.detector_albedo
        * path.detector_cosine_in
        * path.transmission
        * path.detector_cosine_out
        * path.pupil_cosine
        * path.quantum_efficiency
        * path.pixel_area_m2
        / geometry.camera.pixel_pitch_m**2
    )
    numbers = {
        "cell_m": extent / cells,
        "tilt_right": 0.0,
        "tilt_down": 0.0,
        "shift_right_m": 0.0,
        "shift_down_m": 0.0,
        "source_m": path.source_to_object_m,
        "detector_m": path.object_to_detector_m,
        "source_angle": angle,
        "exposure_s": camera.exposure_s,
        "power_w": path.power_w,
        "wavelength_m": path.wavelength_m,
        "pixel_pitch_m": geometry.camera.pixel_pitch_m,
        "pupil_diameter_m": path.pupil_diameter_m,
        "pupil_m": path.detector_to_pupil_m,
        "losses": losses,
    }
    scalars = {name: torch.tensor(float(value), dtype=torch.float64) for name, value in numbers.items()}
    return Setup(
        torch.as_tensor(albedo, dtype=torch.float64),
        **scalars,
        patch=patches_of(geometry, patch)[0].size,
        stretch=hidden.axes.stretch,
    )


def parameters(setup: Setup) -> list[str]:
    """Return the names of all differentiable parameters."""
    return [field.name for field in fields(setup) if field.name not in ("patch", "stretch")]


def cell_light(setup: Setup) -> tuple[Tensor, Tensor]:
    """Return the photoelectrons of each cell in a pixel (m,) and its position as seen from the frame centre, (m, 2),
    rows and columns."""
    n = setup.albedo.shape[0]
    index = (torch.arange(n, dtype=torch.float64) - 0.5 * (n - 1)) * setup.cell_m
    down, right = (part.reshape(-1) for part in torch.meshgrid(index, index, indexing="ij"))
    # Coordinates (down, right, towards the wall); the object rotates about its centre.
    cos_r, sin_r, cos_d, sin_d = (f(angle) for angle in (setup.tilt_right, setup.tilt_down) for f in (torch.cos, torch.sin))
    x = torch.stack(
        [
            down * cos_d + setup.shift_down_m,
            right * cos_r - down * sin_d * sin_r + setup.shift_right_m,
            right * sin_r + down * sin_d * cos_r,
        ],
        1,
    )
    normal = torch.stack([-sin_d, -cos_d * sin_r, cos_d * cos_r])
    zero = torch.zeros((), dtype=torch.float64)
    spot = setup.source_m * torch.stack([zero, torch.sin(setup.source_angle), torch.cos(setup.source_angle)])
    wall = torch.stack([zero, zero, setup.detector_m])
    to_spot, to_wall = spot - x, wall - x
    d1, d2 = to_spot.norm(dim=1), to_wall.norm(dim=1)
    lit, seen = ((way @ normal / length).clamp_min(0.0) for way, length in ((to_spot, d1), (to_wall, d2)))
    photons = setup.power_w * setup.wavelength_m / (Planck * speed_of_light) * setup.exposure_s * setup.losses
    radius = 0.5 * setup.pupil_diameter_m
    caught = radius**2 / (radius**2 + setup.pupil_m**2)
    light = (
        photons
        * caught
        * setup.pixel_pitch_m**2
        * setup.cell_m**2
        / math.pi**2
        * setup.albedo.reshape(-1)
        * lit
        * seen
        / (d1 * d2) ** 2
    )
    return light, x[:, :2] * (setup.detector_m / to_wall[:, 2:])


def mean_photoelectrons(setup: Setup) -> Tensor:
    """Return the expected photoelectrons of one pixel."""
    return cell_light(setup)[0].sum()


def throughput(setup: Setup) -> Tensor:
    """Return the photoelectrons in one pixel per laser photon."""
    photons = setup.power_w * setup.wavelength_m / (Planck * speed_of_light) * setup.exposure_s
    return mean_photoelectrons(setup) / photons


def expected_autocorrelation(setup: Setup) -> Tensor:
    """Return the expected estimate without its floor, (127, 127), in photoelectrons squared: H times r*r smoothed by the window.

    r*r of cells at arbitrary positions is a sum of waves over the patch. Its power under the patch triangle, transformed to lags, is
    the expectation of the estimator.
    """
    light, place = cell_light(setup)
    n = setup.patch
    offset = torch.arange(-(n - 1), n, dtype=torch.float64)
    turns = offset * setup.pixel_pitch_m / (setup.wavelength_m * setup.detector_m)
    # The field of the speckle is correlated like the transform of the light; light and positions factorise per cell.
    phases = [2.0 * math.pi / setup.stretch[axis] * torch.outer(turns, place[:, axis]) for axis in (0, 1)]
    waves = [torch.polar(torch.ones_like(phase), phase) for phase in phases]
    field = (waves[0] * light.to(torch.complex128)) @ waves[1].T
    covariance = field.real.square() + field.imag.square()
    triangle = 1.0 - offset.abs() / n
    lags = torch.arange(-LAGS, LAGS + 1, dtype=torch.float64)
    to_lags = torch.polar(triangle[None].expand(len(lags), -1).clone(), -2.0 * math.pi * torch.outer(lags, offset) / n)
    return (to_lags @ covariance.to(torch.complex128) @ to_lags.T).real * _transfer(setup, lags)


def _transfer(setup: Setup, lags: Tensor) -> Tensor:
    """Return H per lag; see `radiometry/transfer.py`."""
    frequency = lags / (setup.patch * setup.pixel_pitch_m)
    cutoff = setup.pupil_diameter_m / (setup.wavelength_m * setup.pupil_m)
    reduced = (torch.hypot(frequency[:, None], frequency[None] + 1e-12) / cutoff).clamp(1e-9, 1.0 - 1e-9)
    otf = 2.0 / math.pi * (torch.arccos(reduced) - reduced * torch.sqrt(1.0 - reduced.square()))
    pixel = torch.sinc(frequency * setup.pixel_pitch_m)
    return (otf * pixel[:, None] * pixel[None]) ** 2
