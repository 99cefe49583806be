"""Direct propagation: the Rayleigh-Sommerfeld sum over every scatterer and pixel, in Dr.Jit.

Approximation: none beyond k r >> 1. Valid everywhere. Cost: scatterers x pixels. Source: see `sampling.py`.

Phases of 1e7 radians do not fit single precision, so each 64 x 64 tile of pixels has a float64 reference: with c its
centre and u a pixel's offset in it,

    |w - s| - |c - s| = N_s / D_s,    N_s = N_o - 2 u.s,    N_o = 2 u.c + |u|^2,    D_s = |w - s| + |c - s|,

and what is left to single precision is this minus the same for the object's centre, q = -(N_o e + 2 u.s D_o) / ((D_o + e) D_o),
where e = D_s - D_o is q plus twice the path difference at c: found by iteration, each pass thousandfold
nearer. No large numbers are subtracted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import drjit as dr
import numpy as np

from sim.propagation.sampling import Scatterers, Wall, path_difference, phasor

Precision = Literal["float32", "float64"]
Visibility = Callable[[np.ndarray, np.ndarray], np.ndarray]

TILE = 64
_PAIRS_AT_ONCE, _TILES_AT_ONCE = 2**22, 64
"""Tiles x scatterers, and tiles, held in memory at once."""

PAIRS_PER_SECOND = {"float32": 1e9, "float64": 0.35e9}
"""On two cores; only a prediction of time, never a result."""


def direct(scatterers: Scatterers, wall: Wall, *, precision: Precision = "float32", device: str = "cpu",
           visible: Visibility | None = None, progress: Callable[[int], object] = lambda tiles: None) -> np.ndarray:
    """Field on the wall, complex64 or complex128 (H, W).

    Args:
        visible: visible(tile_centres (t, 3), scatterers (n, 3)) -> bool (t, n), from the object's centre; all where None.
        progress: called with the number of tiles done.
    """
    height, width = wall.shape
    kind = np.float32 if precision == "float32" else np.float64
    field = np.zeros(wall.shape, np.complex64 if precision == "float32" else np.complex128)
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
            if visible is not None:
                amplitude = amplitude * visible(centre, position)
            total += _sum_tiles(centre, offset, position, amplitude, difference, wall, kind, device).reshape(total.shape)
        for (row, column), tile in zip(tiles, total, strict=True):
            field[row : row + TILE, column : column + TILE] = tile[: height - row, : width - column]
        progress(len(tiles))
    return field


def _sum_tiles(centre: np.ndarray, offset: np.ndarray, position: np.ndarray, amplitude: np.ndarray,
               difference: np.ndarray, wall: Wall, kind: type, device: str) -> np.ndarray:
    """Field of every pixel of some tiles, complex (tiles, TILE * TILE).

    Args:
        centre: tile centres (t, 3). offset: of pixels in their tile (p, 3). position: of scatterers (n, 3).
        amplitude, difference: complex, with its phase at each tile's centre, and the path difference there (t, n).
    """
    backend = dr.llvm if device == "cpu" else dr.cuda
    real = backend.Float if kind is np.float32 else backend.Float64
    index, four = backend.UInt, backend.Array4f if kind is np.float32 else backend.Array4f64
    count, pixels = len(position), len(offset)
    table = np.empty((len(centre), count, 8), kind)
    table[..., :3] = position
    table[..., 3] = 2.0 * difference
    table[..., 4], table[..., 5] = amplitude.real, amplitude.imag
    table[..., 6:] = 0.0
    data = real(table.ravel())

    tile = np.repeat(np.arange(len(centre)), pixels)
    u = np.tile(offset, (len(centre), 1))
    c = centre[tile]
    reach = np.linalg.norm(c, axis=1)
    to_centre = 2.0 * (u * c).sum(1) + (u * u).sum(1)
    span = np.linalg.norm(c + u, axis=1) + reach
    ux, uy, uz = (real((2.0 * u[:, axis]).astype(kind)) for axis in range(3))
    wx, wy, wz = (real((c + u)[:, axis].astype(kind)) for axis in range(3))
    n_o, d_o = real(to_centre.astype(kind)), real(span.astype(kind))
    turn = 2.0 * np.pi / wall.wavelength_m
    passes = 2 if kind is np.float32 else 8
    nx, ny, nz = (float(part) for part in wall.centre_m)
    base = index((tile * count).astype(np.uint32))

    def step(i, re, im):
        near = dr.gather(four, data, 2 * (base + i))
        wave = dr.gather(four, data, 2 * (base + i) + 1)
        x, y, z = wx - near[0], wy - near[1], wz - near[2]
        square = x * x + y * y + z * z
        cross = (ux * near[0] + uy * near[1] + uz * near[2]) * d_o
        sought = real(0.0)
        for _ in range(passes):
            excess = near[3] + sought
            sought = -(n_o * excess + cross) / ((d_o + excess) * d_o)
        sine, cosine = dr.sincos(sought * turn)
        scale = (nx * x + ny * y + nz * z) / square
        re += scale * (wave[0] * cosine - wave[1] * sine)
        im += scale * (wave[0] * sine + wave[1] * cosine)
        return i + 1, re, im

    _, re, im = dr.while_loop((index(0), real(0.0), real(0.0)), lambda i, re, im: i < count, step)
    dr.eval(re, im)
    return (np.asarray(re) + 1j * np.asarray(im)).reshape(len(centre), pixels)
