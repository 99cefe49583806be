"""Speckle correlation through the memory effect of an incoherently illuminated object, for comparison with correlography.

Katz et al., Nature Photonics 8, 784 (2014), doi:10.1038/nphoton.2014.189. The laser speckle on the object is averaged, so its
cells emit light that does not interfere. The camera is focused at infinity, where each cell shows one speckle pattern of the
wall, displaced by the direction of the cell. The frame is the object convolved with that pattern, and its autocovariance is r*r
times the squared contrast. Three limits apply:

- resolution: a grain of the pattern, lambda z / D on the object;
- contrast: 1 / sqrt(n) for n resolved cells; 1 in correlography;
- field of view: the pattern of a cell results from phases k h (cos i + cos o) of the wall's heights h. A displacement of the cell
  by an angle a changes the cosines by q.a, with q = tan o - tan i as vectors along the wall. The patterns of two cells therefore
  correlate by exp(-(k s q.a)^2) for heights of rms s (Goodman, Speckle Phenomena in Optics, section 5.3). Those of a diffusing
  layer of thickness L correlate by (k L a / sinh k L a)^2 (Freund et al., Phys. Rev. Lett. 61, 2328, doi:10.1103/PhysRevLett.61.2328).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.fft import next_fast_len

from correlograph.errors import InputError
from radiometry.light_budget_rows import light_budget
from radiometry.prediction import patches_of
from sim.geometry import Geometry

OVERSAMPLING = 2
"""Pixels per grain."""


@dataclass(frozen=True)
class MemoryEffect:
    """A scene imaged through the memory effect; its stop makes the grain equal to the lag pitch of the correlography estimate.

    Attributes:
        cells: albedo of the object, one cell per grain, (64, 64), sum 1.
        pitch_m: grain on the object.
        aperture_m: diameter of the stop.
        frame_shape: pixels, `OVERSAMPLING` per grain; the solid angle is that of the scene's frame.
        photoelectrons_per_pixel_s: mean over the frame.
        decorrelation: k s q of the module docstring along rows and columns, per radian.
    """

    cells: np.ndarray
    pitch_m: float
    distance_m: float
    aperture_m: float
    frame_shape: tuple[int, int]
    photoelectrons_per_pixel_s: float
    decorrelation: tuple[float, float]

    @classmethod
    def of(cls, geometry: Geometry) -> MemoryEffect:
        """Return the scene's own camera, refocused and stopped down.

        Raises InputError if the virtual detector has no roughness.
        """
        if geometry.wall.height_rms_m is None:
            raise InputError(
                "virtual_detector",
                "a phase_screen, whose roughness limits the memory effect",
                "another BSDF",
                "wrap it in a phase_screen",
            )
        _, (pitch_m, _) = patches_of(geometry)
        cells = geometry.hidden_object.cell_means(pitch_m, 64).astype(np.float64)
        aperture_m = geometry.wavelength_m * geometry.distance_m / pitch_m
        pixel = pitch_m / geometry.distance_m / OVERSAMPLING
        angle = geometry.camera.pixel_pitch_m / geometry.camera.pupil_distance_m
        stopped = (aperture_m / geometry.camera.pupil_diameter_m) ** 2
        rate = light_budget(geometry.light_path).photoelectrons_per_pixel_s * stopped * (pixel / angle) ** 2
        height, width = geometry.camera.frame_shape
        return cls(
            cells / cells.sum(),
            pitch_m,
            geometry.distance_m,
            aperture_m,
            (int(height * angle / pixel), int(width * angle / pixel)),
            rate,
            _decorrelation(geometry),
        )

    @property
    def contrast(self) -> float:
        """Contrast of the frame for grains of the size of the object's cells: 1 / sqrt(number of bright cells)."""
        return float(np.sqrt((self.cells**2).sum()))

    @property
    def field_of_view_m(self) -> float:
        """Distance on the object at which the correlation of the pattern falls to 1 / e."""
        return self.distance_m / max(float(np.hypot(*self.decorrelation)), 1e-12)

    def signal_to_noise(self, seconds: float) -> float:
        """Return the autocovariance at small lags over its standard deviation by shot noise, in one frame of a duration."""
        mean = self.photoelectrons_per_pixel_s * seconds
        return float(mean * self.contrast**2 * np.sqrt(np.prod(self.frame_shape)))

    def frame(self, seconds: float, rng: np.random.Generator) -> np.ndarray:
        """Return one noisy frame; each call uses another, independent position on the wall, (H, W)."""
        side = next_fast_len(max(self.frame_shape) + 64 * OVERSAMPLING)
        across = side // OVERSAMPLING  # diameter of the aperture in pixels of the grain
        place = (np.arange(across) + 0.5) / across - 0.5
        stop = torch.from_numpy((np.hypot(place[:, None], place) <= 0.5).astype(np.float32))
        phase = torch.from_numpy(rng.uniform(0.0, 2.0 * np.pi, stop.shape).astype(np.float32))
        heights = torch.from_numpy(rng.standard_normal(stop.shape).astype(np.float32))  # normalised to their rms
        height, width = self.frame_shape
        image = torch.zeros(self.frame_shape)
        for row, column in np.argwhere(self.cells > 1e-3 * self.cells.max()).tolist():
            turn = (self.decorrelation[0] * (row - 31.5) + self.decorrelation[1] * (column - 31.5)) * self.pitch_m
            wall = torch.polar(stop, phase + turn / self.distance_m * heights)
            pattern = torch.fft.fft2(wall, s=(side, side)).abs().square()
            top, left = (63 - row) * OVERSAMPLING, (63 - column) * OVERSAMPLING
            image.add_(pattern[top : top + height, left : left + width], alpha=float(self.cells[row, column] / stop.sum()))
        return rng.poisson(image.double().numpy() * self.photoelectrons_per_pixel_s * seconds).astype(np.float64)

    def within(self, thickness_m: float, wavelength_m: float) -> float:
        """Return the field of view of a diffusing layer: (k L a / sinh k L a)^2 is 1 / e at k L a = 1.817."""
        return self.distance_m * 1.817 * wavelength_m / (2.0 * np.pi * thickness_m)


def _decorrelation(geometry: Geometry) -> tuple[float, float]:
    """Return k s q along the object's axes (rows, columns)."""
    normal = np.cross(geometry.camera.down, geometry.camera.right)
    normal *= np.sign(normal @ (geometry.hidden_object.centre - geometry.camera.centre)) / np.linalg.norm(normal)
    slopes = []
    for end in (geometry.camera.pupil_centre, geometry.hidden_object.centre):
        way = end - geometry.camera.centre
        slopes.append(way / (way @ normal) - normal)
    q = 2.0 * np.pi * geometry.wall.height_rms_m / geometry.wavelength_m * (slopes[0] - slopes[1])
    axes = geometry.hidden_object.axes
    return float(q @ axes.down), float(q @ axes.right)


def autocovariance(frames: list[np.ndarray]) -> np.ndarray:
    """Return the autocovariance of frames at lags that are multiples of one grain, averaged over pixel pairs; (127, 127)."""
    total = np.zeros((127, 127))
    for frame in frames:
        height, width = (n // OVERSAMPLING * OVERSAMPLING for n in frame.shape)
        binned = frame[:height, :width].reshape(height // OVERSAMPLING, OVERSAMPLING, width // OVERSAMPLING, OVERSAMPLING)
        grains = binned.sum((1, 3))
        padded = [2 * n for n in grains.shape]

        def correlate(image: np.ndarray, shape: list[int] = padded) -> np.ndarray:
            return np.fft.irfft2(np.abs(np.fft.rfft2(image, s=shape)) ** 2, s=shape)

        pairs = correlate(np.ones_like(grains))
        lags = correlate(grains - grains.mean()) / np.maximum(pairs, 1.0)
        reach = [min(63, n - 1) for n in grains.shape]
        rows, columns = (np.arange(-n, n + 1) for n in reach)
        total[63 - reach[0] : 64 + reach[0], 63 - reach[1] : 64 + reach[1]] += lags[np.ix_(rows, columns)]
    return total / len(frames)
