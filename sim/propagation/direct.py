"""Direct propagation: the Rayleigh-Sommerfeld sum over every scatterer and pixel, in Dr.Jit.

Approximation: none except k r >> 1. Valid everywhere. Cost: scatterers x pixels. Source: see `sampling.py`.

Phases of 1e7 radians do not fit single precision, so each 64 x 64 tile of pixels has a float64 reference. Let c be its centre, u
the offset of a pixel and w = c + u. The path of a scatterer s exceeds that of the object's centre by d = |c - s| - |c| at c and by
d + q at w. Both differences have the form (|a + u|^2 - |a|^2) / (|a + u| + |a|), which gives

    q^2 + (b + 2 d) q + 2 u.s + 2 d n = 0,    n = (2 u.c + |u|^2) / D,    b = D + n,    D = |w| + |c|.

Single precision computes the small root without subtraction of large numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import numpy as np
import torch

from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Scatterers, Wall, path_difference, phasor
from sim.propagation.validity import direct_error

TILE = 64
_PAIRS_AT_ONCE, _TILES_AT_ONCE = 2**22, 64
"""Tiles x scatterers, and tiles, in memory at once."""
_PIXELS_A_LANE = 8
"""Pixels of a tile that one Dr.Jit lane computes per read of a scatterer."""

PAIRS_PER_SECOND = {"float32": 2e9, "float64": 1e9}
"""Speed on two cores; it predicts times only."""

SECONDS_ONCE = 0.004


def predict(task: Task) -> list[Option]:
    tiles = math.prod(math.ceil(pixels / TILE) for pixels in task.wall.shape)
    return [
        Option(
            "direct",
            precision,
            direct_error(task.wall, task.scatterers, precision, TILE),
            SECONDS_ONCE + tiles * TILE**2 * len(task.scatterers) / PAIRS_PER_SECOND[precision],
            8 * math.prod(task.wall.shape) + 2**28,
            "every scatterer to every pixel",
        )
        for precision in task.precisions
    ]


def propagate(scatterers: Scatterers, wall: Wall, terms: Terms) -> torch.Tensor:
    """Return the field on the wall, complex64 or complex128 (H, W)."""
    height, width = wall.shape
    dtype = np.float32 if terms.precision == "float32" else np.float64
    field = np.zeros(wall.shape, np.complex64 if terms.precision == "float32" else np.complex128)
    corners = [(row, column) for row in range(0, height, TILE) for column in range(0, width, TILE)]
    chunk = max(1, min(len(scatterers), _PAIRS_AT_ONCE))
    together = min(_TILES_AT_ONCE, max(1, _PAIRS_AT_ONCE // chunk))
    inner = np.arange(TILE) - 0.5 * (TILE - 1)
    offset = (inner[:, None, None] * wall.down + inner[None, :, None] * wall.right).reshape(-1, 3) * wall.pitch_m
    for first in range(0, len(corners), together):
        tiles = corners[first : first + together]
        middle = np.array(tiles, np.float64) + 0.5 * (TILE - 1)
        centre = wall.pixels(middle[:, 0], middle[:, 1])
        total = np.zeros((len(tiles), TILE, TILE), field.dtype)
        for start in range(0, len(scatterers), chunk):
            position = scatterers.position_m[start : start + chunk]
            difference = path_difference(centre[:, None], position[None])
            amplitude = scatterers.amplitude[start : start + chunk] * phasor(difference, wall.wavelength_m)
            if terms.visible is not None:
                amplitude = amplitude * terms.visible(centre, position)
            chosen = _Part(position, amplitude, difference)
            total += _sum_tiles(centre, offset, chosen, wall, dtype, terms.device).reshape(total.shape)
        for (row, column), tile in zip(tiles, total, strict=True):
            field[row : row + TILE, column : column + TILE] = tile[: height - row, : width - column]
    return torch.from_numpy(field).to(terms.device)


@dataclass(frozen=True)
class _Part:
    """Some scatterers.

    Attributes:
        position: (n, 3).
        amplitude: complex amplitude of each scatterer, with its phase at each tile's centre, (t, n).
        difference: path from each scatterer to each tile's centre minus the path from the object's centre, (t, n).
    """

    position: np.ndarray
    amplitude: np.ndarray
    difference: np.ndarray


def _sum_tiles(
    centre: np.ndarray,
    offset: np.ndarray,
    part: _Part,
    wall: Wall,
    dtype: type,
    device: str,
) -> np.ndarray:
    """Return the field of every pixel of some tiles, complex (tiles, TILE * TILE).

    Args:
        centre: tile centres (t, 3). offset: pixel offsets within their tile (p, 3).
    """
    backend = dr.llvm if device == "cpu" else dr.cuda
    real = backend.Float if dtype is np.float32 else backend.Float64
    index, exact, four = backend.UInt, backend.Array3f64, backend.Array4f if dtype is np.float32 else backend.Array4f64
    count, pixels = len(part.position), len(offset)
    table = np.empty((len(centre), count, 8), dtype)
    table[..., :3] = part.position
    table[..., 3] = 2.0 * part.difference
    table[..., 4], table[..., 5] = part.amplitude.real, part.amplitude.imag
    table[..., 6:] = 0.0
    data = real(table.ravel())

    lanes = pixels // _PIXELS_A_LANE
    lane = dr.arange(index, len(centre) * lanes)
    c = dr.gather(exact, exact(centre.T), lane // lanes)
    constants = []
    for own in range(_PIXELS_A_LANE):
        u = dr.gather(exact, exact(offset.T), lane % lanes * _PIXELS_A_LANE + own)
        span = dr.norm(c + u) + dr.norm(c)
        beyond = (2.0 * dr.dot(u, c) + dr.dot(u, u)) / span
        constants.append([real(value) for value in (*(2.0 * u), *(c + u), beyond, span + beyond)])
    base = lane // lanes * count
    turn = 2.0 * np.pi / wall.wavelength_m
    nx, ny, nz = (float(part) for part in wall.centre_m)

    def step(i, sums):
        near = dr.gather(four, data, 2 * (base + i))
        wave = dr.gather(four, data, 2 * (base + i) + 1)
        added = []
        for (ux, uy, uz, wx, wy, wz, n, b), (re, im) in zip(constants, sums, strict=True):
            x, y, z = wx - near[0], wy - near[1], wz - near[2]
            linear = b + near[3]
            constant = ux * near[0] + uy * near[1] + uz * near[2] + n * near[3]
            excess = -2.0 * constant / (linear + dr.sqrt(linear * linear - 4.0 * constant))
            sine, cosine = dr.sincos(excess * turn)
            scale = (nx * x + ny * y + nz * z) / (x * x + y * y + z * z)
            added.append((re + scale * (wave[0] * cosine - wave[1] * sine), im + scale * (wave[0] * sine + wave[1] * cosine)))
        return i + 1, added

    nothing = [(real(0.0), real(0.0)) for _ in constants]
    _, sums = dr.while_loop((index(0), nothing), lambda i, sums: i < count, step)
    dr.eval(sums)
    field = np.stack([np.asarray(re) + 1j * np.asarray(im) for re, im in sums], 1)
    return field.reshape(len(centre), pixels)
