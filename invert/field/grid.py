"""Grids of a frame and of the field on the object, and the Fourier transform between them.

The field on the wall is the Fourier transform of the field on the object, whose Fresnel phase does not change the intensity
(Goodman, Introduction to Fourier Optics, Eq. 4-17). A frame of N pixels therefore resolves cells of 1 / N of the patch that has
one lag per pixel: lambda z / (N pitch). Only cells in the bounding box of the object are kept. They lie at the corner of the
periodic grid, because a shift of the object changes only the phase on the wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.fft import next_fast_len

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata
from radiometry.field_forecast import MIN_CAMERA_GRAIN_PIXELS, Box
from radiometry.transfer import amplitude_transfer

MIN_GRAIN_PIXELS = 2.5
"""Minimum speckle grain of the object's bounding box in binned pixels. Intensity has twice the bandwidth of the field, so 2 is the
Nyquist limit."""

PADDING_GRAINS = 4.0
"""Unmeasured border of the periodic grid, in grains, so that opposite edges of a frame are independent."""


@dataclass(frozen=True)
class FieldGrid:
    """Grids (rows, columns) of one frame.

    Attributes:
        binning: camera pixels per binned pixel.
        frame_shape: binned pixels of the frame, at the corner of the periodic grid.
        shape: binned pixels of the periodic grid.
        box_shape: cells of the object's bounding box.
        cell_lags: width of a cell in lags of the coarse albedo.
        origin_lags: position of the first cell in pixels of the coarse albedo.
    """

    binning: tuple[int, int]
    frame_shape: tuple[int, int]
    shape: tuple[int, int]
    box_shape: tuple[int, int]
    cell_lags: tuple[float, float]
    origin_lags: tuple[float, float]

    @property
    def measured_fraction(self) -> float:
        """Fraction of the periodic grid that the frame covers."""
        return math.prod(self.frame_shape) / math.prod(self.shape)

    @property
    def pixels_per_grain(self) -> float:
        """Binned pixels per speckle grain of the bounding box."""
        return math.prod(self.shape) / math.prod(self.box_shape)

    def to_wall(self, field: torch.Tensor) -> torch.Tensor:
        """Return the field on the wall (..., rows, columns) of a field on the object's box."""
        rows, columns = self.shape
        return torch.fft.fft(torch.fft.fft(field, n=columns, norm="ortho"), n=rows, dim=-2, norm="ortho")

    def to_object(self, wall: torch.Tensor) -> torch.Tensor:
        """Return the field on the object's box of a field on the wall; the adjoint of `to_wall`."""
        rows, columns = self.box_shape
        return torch.fft.ifft(torch.fft.ifft(wall, dim=-2, norm="ortho")[..., :rows, :], norm="ortho")[..., :columns]

    def on_frame(self, wall: torch.Tensor) -> torch.Tensor:
        """Return the part of an array on the wall that the frame covers, as a view."""
        return wall[..., : self.frame_shape[0], : self.frame_shape[1]]

    def bin(self, frame: np.ndarray) -> torch.Tensor:
        """Return the sums over the camera pixels of each binned pixel, float32; pixels that fill no binned pixel are left out."""
        (rows, columns), (down, right) = self.frame_shape, self.binning
        blocks = torch.as_tensor(np.ascontiguousarray(frame[: rows * down, : columns * right], np.float32))
        return blocks.reshape(rows, down, columns, right).sum((1, 3))

    def transfer(self, camera: CameraMetadata, blur_pixels: tuple[float, float]) -> torch.Tensor:
        """Return the transfer function of the intensity at the frequencies of an rfft2 of the periodic grid.

        It is that of pixel, binning, Gaussian blur and, if it is known, pupil.
        """
        frequency = [
            np.fft.fftfreq(self.shape[0], self.binning[0])[:, None],
            np.fft.rfftfreq(self.shape[1], self.binning[1])[None, :],
        ]
        pitch, pupil, distance = camera.pixel_pitch_m, camera.pupil_diameter_m, camera.pupil_distance_m
        if camera.lag_geometry is not None and pitch and pupil and distance:
            row, column = (one / pitch for one in frequency)
            transfer = amplitude_transfer(row, column, pitch, pupil, camera.wavelength_m, distance)
        else:
            transfer = np.sinc(frequency[0]) * np.sinc(frequency[1])
        for one, count, blur in zip(frequency, self.binning, blur_pixels, strict=True):
            offsets = np.arange(count) - 0.5 * (count - 1)
            transfer = transfer * np.cos(2.0 * np.pi * one[..., None] * offsets).mean(-1)
            transfer = transfer * np.exp(-2.0 * (np.pi * blur * one) ** 2)
        return torch.from_numpy(transfer.astype(np.float32))

    def lag_positions(self) -> list[np.ndarray]:
        """Return the positions of the cells along each axis in pixels of the coarse albedo."""
        return [
            origin + width * np.arange(count)
            for origin, width, count in zip(self.origin_lags, self.cell_lags, self.box_shape, strict=True)
        ]


def field_grid(frame_shape: tuple[int, int], patch_shape: tuple[int, int], box_lags: Box) -> FieldGrid:
    """Choose the grids for frames of `frame_shape` pixels and an object within `box_lags`.

    Args:
        patch_shape: pixels of the patch whose lags are the pixels of the coarse albedo.
        box_lags: first and last position of the object (rows, columns) in pixels of the coarse albedo.

    Raises InputError if grains of the object are smaller than two camera pixels, because the intensity is then undersampled.
    """
    binning, framed, shape, box, cells = [], [], [], [], []
    for frame, patch, first, last in zip(frame_shape, patch_shape, *box_lags, strict=True):
        grain = patch / (last - first)
        if grain < MIN_CAMERA_GRAIN_PIXELS:
            found = f"grains of {grain:.2g} pixels"
            raise InputError(
                "frames",
                "speckle grains of at least 2 pixels for --method field",
                found,
                "magnify the wall or use another method",
            )
        binning.append(max(1, int(grain / MIN_GRAIN_PIXELS)))
        framed.append(frame // binning[-1])
        shape.append(_fast_even_length(math.ceil(framed[-1] + PADDING_GRAINS * grain / binning[-1])))
        cells.append(patch / (shape[-1] * binning[-1]))
        box.append(math.ceil((last - first) / cells[-1]) + 1)
    pair = lambda values: (values[0], values[1])  # noqa: E731
    return FieldGrid(pair(binning), pair(framed), pair(shape), pair(box), pair(cells), box_lags[0])


def _fast_even_length(least: int) -> int:
    length = next_fast_len(least)
    while length % 2:
        length = next_fast_len(length + 1)
    return length
