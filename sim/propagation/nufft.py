"""Propagation from scatterers in space to patches of the wall by non-uniform FFTs (finufft; cufinufft on a GPU).

In a patch of centre c, the path difference at pixel offset u is p(c, s) + u.g(s) + remainder. The phase of p multiplies the
amplitude of scatterer s. The term with g = (c - s) / |c - s| - c / |c| is a non-uniform FFT over the pixels u. The slowly
varying remainder, together with the amplitude of the kernel, is a short sum of products alpha_j(u) beta_j(s), found by a
singular value decomposition on Chebyshev nodes of patch and object. The tolerance therefore controls the relative error of
the field, for any depth and tilt. The method is valid while that sum is short; patches are halved until it is.
Cost: patches x terms x (scatterers x kernel width^2 + an FFT of the patch).
Source: Barnett, Magland, af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019), doi:10.1137/18M120885X.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.polynomial.chebyshev import chebpts1, chebvander

from correlograph.errors import InputError
from sim.propagation.option import Option, Precision, Task, Terms
from sim.propagation.sampling import Scatterers, Wall, kernel, path_difference, phasor

MAX_PATCH, MIN_PATCH = 513, 33
MAX_TERMS = 20
_NODES_PATCH, _NODES_OBJECT = 10, 9
TOLERANCE = {"float32": (1e-5, 1e-2), "float64": (1e-11, 1e-2)}
"""Minimum and maximum tolerance in each precision."""

SECONDS = (0.003, 0.017, 3e-7, 2.5e-8)
"""Duration in seconds: once; per patch; per term and scatterer of a patch; per term and pixel. On two cores; it ranks
propagators."""

FINUFFT_SHARE_OF_TOLERANCE = 0.3

FINUFFT_ERROR = 0.7
"""Error of finufft in units of its tolerance: 0.45 to 1.1 measured."""

ROUNDING = {"float32": 9e-8, "float64": 1e-16}
"""Error of positions rounded to the precision, per pixel of a patch's side."""

MIN_ERROR = {"float32": 0.0, "float64": 1e-11}
"""Minimum predicted error."""


_Basis = tuple[np.ndarray, list[np.ndarray]]


@dataclass(frozen=True)
class _Expansion:
    """Expansion of the slowly varying remainder for one patch as a sum of products: alpha at pixels (terms, P, P), beta at
    the scatterers (terms, n), error at random pairs.
    """

    alpha: np.ndarray
    beta: np.ndarray
    error: float


@dataclass(frozen=True)
class Patches:
    """Division of a wall into patches, and their expansion.

    Attributes:
        size: pixels along a side, odd.
        terms: number of products in the sum.
        tolerance: tolerance of the plan.
        error: predicted relative L2 error of the field.
    """

    size: int
    terms: int
    tolerance: float
    error: float

    @property
    def eps(self) -> float:
        """Relative tolerance of finufft, a fraction of that of the plan."""
        return max(FINUFFT_SHARE_OF_TOLERANCE * self.tolerance, 1e-14)


def predict(task: Task) -> list[Option]:
    holding = [precision for precision in task.precisions if 0.5 * task.tolerance >= TOLERANCE[precision][0]]
    return [_predict(task, precision) for precision in holding or task.precisions[-1:]]


def _predict(task: Task, precision: Precision) -> Option:
    low, high = TOLERANCE[precision]
    wall, scatterers = task.wall, task.scatterers
    try:
        patches = plan_patches(scatterers.position_m, wall, min(max(0.5 * task.tolerance, low), high), precision)
    except InputError:
        return Option("nufft", precision, math.inf, math.inf, 0, "the sum of products does not converge this close")
    size, terms = patches.size, patches.terms
    count = math.ceil(wall.shape[0] / size) * math.ceil(wall.shape[1] / size)
    once, each, scatterer, pixel = SECONDS
    seconds = once + count * (each + terms * (scatterer * len(scatterers) + pixel * size**2))
    memory = 16 * terms * (size**2 * 5 + 2 * len(scatterers)) + 16 * math.prod(wall.shape)
    return Option(
        "nufft",
        precision,
        patches.error,
        seconds,
        memory,
        f"{terms} terms in each of {count} patches of {size} pixels",
        patches,
    )


def propagate(scatterers: Scatterers, wall: Wall, terms: Terms) -> torch.Tensor:
    """Return the field on the wall, complex64 or complex128 (H, W), with a relative L2 error of at most the tolerance.

    `terms.patches` come from `plan_patches` for scatterers at the same positions, wall and precision. Progress counts patches.

    Raises InputError for a tolerance below the precision, if the smallest patch needs too many terms, and for a GPU without
    cufinufft.
    """
    patches = terms.patches or plan_patches(scatterers.position_m, wall, terms.tolerance, terms.precision)
    object_basis = _object_basis(scatterers.position_m)
    size, summands = patches.size, patches.terms
    height, width = wall.shape
    dtype = np.complex64 if terms.precision == "float32" else np.complex128
    transform = _transform(patches, dtype, terms.device)
    field = np.empty(wall.shape, dtype)
    for row in range(0, height, size):
        for column in range(0, width, size):
            centre = wall.pixels(np.array(row + 0.5 * (size - 1)), np.array(column + 0.5 * (size - 1)))
            expansion = _expand(centre, size, wall, scatterers.position_m, object_basis, summands)
            if expansion.error > 5.0 * patches.tolerance:
                raise InputError(
                    "--tolerance", f"{expansion.error:.2g} or more in this scene", patches.tolerance, "use --propagator direct"
                )
            gradient = 2.0 * np.pi / wall.wavelength_m * wall.pitch_m * _gradient(centre, scatterers.position_m)
            places = [np.ascontiguousarray(gradient @ axis, dtype(0).real.dtype) for axis in (wall.down, wall.right)]
            first = scatterers.amplitude * phasor(path_difference(centre, scatterers.position_m), wall.wavelength_m)
            waves = transform(places, np.ascontiguousarray(expansion.beta * first, dtype)).reshape(summands, size, size)
            patch = (expansion.alpha * waves).sum(0)
            field[row : row + size, column : column + size] = patch[: height - row, : width - column]
    return torch.from_numpy(field).to(terms.device)


def _transform(patches: Patches, dtype: type, device: str) -> Callable[[list[np.ndarray], np.ndarray], np.ndarray]:
    """Return a planned non-uniform FFT of weights (terms, n) at positions [(n,), (n,)] to (terms, P, P)."""
    shape = (patches.size, patches.size)
    options = {"n_trans": patches.terms, "eps": patches.eps, "isign": 1, "dtype": dtype}
    if device == "cpu":
        import finufft

        plan = finufft.Plan(1, shape, **options)

        def on_cpu(places: list[np.ndarray], weights: np.ndarray) -> np.ndarray:
            plan.setpts(*places)
            return plan.execute(weights)

        return on_cpu
    try:
        import cufinufft
    except ImportError:
        raise InputError(
            "--propagator nufft on a GPU",
            "the package cufinufft",
            "none",
            "pip install correlograph[cuda], or --propagator direct",
        ) from None
    plan = cufinufft.Plan(1, shape, **options)
    of_out = torch.complex64 if dtype is np.complex64 else torch.complex128
    out = torch.empty(patches.terms, *shape, dtype=of_out, device=device)

    def on_gpu(places: list[np.ndarray], weights: np.ndarray) -> np.ndarray:
        plan.setpts(*(torch.from_numpy(place).to(device) for place in places))
        return plan.execute(torch.from_numpy(weights).to(device), out=out).cpu().numpy()

    return on_gpu


def plan_patches(position_m: np.ndarray, wall: Wall, tolerance: float, precision: str) -> Patches:
    """Return the largest patches that meet a tolerance at the corners and the centre of the frame.

    Raises InputError for a tolerance below the precision, and if the smallest patch needs more than `MAX_TERMS`.
    """
    low, high = TOLERANCE[precision]
    if not low <= tolerance <= high:
        raise InputError(
            "--tolerance",
            f"between {low:g} and {high:g} for nufft in {precision}",
            tolerance,
            "choose another, or --precision float64",
        )
    few = position_m[:: max(1, len(position_m) // 500)]
    basis = _object_basis(few)
    rows, columns = (np.array([0.0, 0.5, 1.0]) * (pixels - 1.0) for pixels in wall.shape)
    places = [
        wall.pixels(np.array(row), np.array(column))
        for row, column in ((rows[1], columns[1]), *((row, column) for row in rows[::2] for column in columns[::2]))
    ]
    size = min(MAX_PATCH, max(wall.shape) | 1)
    while size >= MIN_PATCH:
        terms, sums = 0, []
        own = math.hypot(FINUFFT_ERROR * FINUFFT_SHARE_OF_TOLERANCE * tolerance, ROUNDING[precision] * size)
        for centre in places:
            value = _decompose(centre, size, wall, basis[0])[1]
            tail = np.sqrt(np.append(np.cumsum(value[::-1] ** 2)[::-1], 0.0) / (value**2).sum())
            terms = max(terms, int(np.argmax(tail < 0.3 * tolerance)))
            if terms > MAX_TERMS:
                break
            sums.append(_expand(centre, size, wall, few, basis, terms).error)
            if math.hypot(own, sums[-1]) > tolerance:
                break
        else:
            error = math.hypot(own, float(np.sqrt(np.mean(np.square(sums)))))
            return Patches(size, terms, tolerance, max(MIN_ERROR[precision], error))
        size = (size // 2) | 1
    raise InputError(
        "--propagator", "a scene whose phases nufft can expand", "one too close or too deep for it", "use --propagator direct"
    )


def _gradient(centre: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the derivative of the path difference with respect to the pixel position, (n, 3)."""
    ray = centre - position
    return ray / np.linalg.norm(ray, axis=1)[:, None] - centre / np.linalg.norm(centre)


def _decompose(centre: np.ndarray, size: int, wall: Wall, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the singular value decomposition of the slowly varying remainder between nodes of the patch and of the object."""
    u = chebpts1(_NODES_PATCH) * 0.5 * size * wall.pitch_m
    offsets = (u[:, None, None] * wall.down + u[None, :, None] * wall.right).reshape(-1, 3)
    return np.linalg.svd(_slow(centre, offsets, nodes, wall), full_matrices=False)


def _expand(centre: np.ndarray, size: int, wall: Wall, position: np.ndarray, basis: _Basis, terms: int) -> _Expansion:
    left, value, right = _decompose(centre, size, wall, basis[0])
    alpha = (left[:, :terms] * value[:terms]).reshape(_NODES_PATCH, _NODES_PATCH, terms)
    fine = interpolation(_NODES_PATCH, (np.arange(size) - 0.5 * (size - 1)) / (0.5 * size))
    pixels = np.einsum("pa,abt,qb->tpq", fine, alpha, fine, optimize=True)
    beta = _at_scatterers(right[:terms], basis[1])
    rng = np.random.default_rng(size)
    rows, columns, chosen = (rng.integers(n, size=64) for n in (size, size, len(position)))
    middle = 0.5 * (size - 1)
    places = ((rows - middle)[:, None] * wall.down + (columns - middle)[:, None] * wall.right) * wall.pitch_m
    exact = np.diagonal(_slow(centre, places, position[chosen], wall))
    ours = (pixels[:, rows, columns] * beta[:, chosen]).sum(0)
    return _Expansion(pixels, beta, float(np.linalg.norm(ours - exact) / np.linalg.norm(exact)))


def _slow(centre: np.ndarray, offsets: np.ndarray, position: np.ndarray, wall: Wall) -> np.ndarray:
    """Return the kernel K without its phase at the patch centre and its linear phase over the patch, (offsets, scatterers)."""
    linear = path_difference(centre, position)[None] + offsets @ _gradient(centre, position).T
    return kernel(wall, (centre + offsets)[:, None], position[None]) * phasor(-linear, wall.wavelength_m)


def interpolation(count: int, x: np.ndarray) -> np.ndarray:
    """Return the values at x (n,) in [-1, 1] of the Lagrange polynomials of the Chebyshev nodes, (n, count)."""
    weight = np.where(np.arange(count) == 0, 1.0, 2.0) / count
    return (chebvander(np.clip(x, -1.0, 1.0), count - 1) * weight) @ chebvander(chebpts1(count), count - 1).T


def _object_basis(position: np.ndarray) -> _Basis:
    """Return Chebyshev nodes (N, 3) in the object's bounding box, and per axis their Lagrange polynomials at the scatterers."""
    low, high = position.min(0), position.max(0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-12)
    counts = [_NODES_OBJECT if extent > 1e-9 else 1 for extent in half]
    axes = [middle[axis] + half[axis] * chebpts1(count) for axis, count in enumerate(counts)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return nodes, [interpolation(count, (position[:, axis] - middle[axis]) / half[axis]) for axis, count in enumerate(counts)]


def _at_scatterers(at_nodes: np.ndarray, values: list[np.ndarray], chunk: int = 4096) -> np.ndarray:
    """Interpolate fields at the N Chebyshev nodes of the object, (terms, N), to its n scatterers, (terms, n).

    Args:
        at_nodes: one row for each term of the low-rank expansion.
        values: the interpolation polynomials at the scatterers, for each axis.
    """
    cube = at_nodes.reshape(len(at_nodes), *(value.shape[1] for value in values))
    parts = []
    for start in range(0, len(values[0]), chunk):
        x, y, z = (value[start : start + chunk] for value in values)
        along_z = (cube.reshape(-1, cube.shape[3]) @ z.T).reshape(*cube.shape[:3], -1)
        parts.append(((along_z * y.T).sum(2) * x.T).sum(1))
    return np.concatenate(parts, axis=1)
