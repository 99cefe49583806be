"""`python -m benchmarks.third_order`: what the third order of the frames adds to the second.

If the field on the object has the variances r, the counts of a frame have correlations of second order, with the spectrum r * r, and of
third order, whose phases are closure phases. Let d(k) be the spectrum of the counts without their mean, divided by its variance. The
statistics that change most with a small change q of r are then

    T2 = sum over cells i, j of q_i r_j |d(i - j)|^2,    T3 = sum over cells i, j, k of q_i r_j r_k d(i - j) d(j - k) d(k - i).

Frames of r + q and r - q are simulated from the same random numbers. The information about the size of q is J^T C^-1 J, with the change J
of the means and the covariance C of the statistics. The table has one row per number of photons per grain of the object's bounding box:
by what fraction T3 raises the information of T2, on average over objects and changes, and its standard error.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from data_gen.shapes import strokes

PHOTONS_PER_GRAIN = (0.1, 0.3, 1.0, 3.0, 10.0)

CELLS = 32
"""Cells of the object's bounding box along each axis."""

PIXELS = 80
"""Pixels of the frame along each axis: 2.5 per grain, as in `invert.field.grid`."""

SMOOTHING_CELLS = 3.0
"""Standard deviation of the Gaussian that smooths the changes: a lag is four cells wide if a frame is four patches wide."""

CHANGE = 0.3
"""Standard deviation of a change relative to the albedo."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=int, default=6, help="objects, with one change each")
    parser.add_argument("--frames", type=int, default=200, help="frames per object")
    options = parser.parse_args(argv)
    print("| photons per grain | information added by the third order |\n|---|---|")
    for photons in PHOTONS_PER_GRAIN:
        added = [added_information(seed, photons, options.frames) for seed in range(options.objects)]
        print(f"| {photons:g} | {np.mean(added):.3f} +- {np.std(added, ddof=1) / len(added) ** 0.5:.3f} |", flush=True)


def added_information(seed: int, photons: float, frames: int) -> float:
    """Return by what fraction T3 raises the information of T2 about a change of an object."""
    rng = np.random.default_rng(seed)
    albedo = draw_object(rng)
    smooth = ndimage.gaussian_filter(rng.standard_normal(albedo.shape), SMOOTHING_CELLS)
    change = albedo * smooth * (CHANGE / smooth.std())
    change -= albedo * (change.sum() / albedo.sum())
    change = np.clip(change, -0.9 * albedo, 0.9 * albedo)
    scale = photons * CELLS**2 / albedo.sum()  # mean counts of a frame: photons per grain times grains
    pairs = np.array([_statistics(albedo * scale, change * scale, rng) for _ in range(frames)])  # frames, sign, statistic
    shift = 0.5 * (pairs[:, 0] - pairs[:, 1])
    inverse = np.linalg.inv(0.5 * (np.cov(pairs[:, 0].T) + np.cov(pairs[:, 1].T)))
    variance = 0.5 * (pairs[:, 0, 0].var(ddof=1) + pairs[:, 1, 0].var(ddof=1))
    noise = np.cov(shift.T) / frames  # of the mean shift; without it, chance counts as information
    square = np.outer(shift.mean(0), shift.mean(0)) - noise
    return float((inverse * square).sum() / (square[0, 0] / variance) - 1.0)


def draw_object(rng: np.random.Generator) -> np.ndarray:
    """Return an object that fills its bounding box (CELLS, CELLS)."""
    image = strokes(rng)
    rows, columns = np.nonzero(image > 0.0)
    cut = image[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    return ndimage.zoom(cut, [CELLS / side for side in cut.shape], order=1, grid_mode=True, mode="nearest").clip(0.0)


def _statistics(albedo: np.ndarray, change: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return T2 and T3 of a frame of albedo + change and of one of albedo - change (2, 2), which share their random numbers.

    Args:
        albedo: variances of the field in counts per frame (CELLS, CELLS).
    """
    parts = rng.standard_normal((2, *albedo.shape)) * 0.5**0.5
    expected = [_intensity(np.sqrt(albedo + sign * change) * (parts[0] + 1j * parts[1])) for sign in (1.0, -1.0)]
    both = rng.poisson(np.minimum(*expected))
    places = np.argwhere(albedo > 0.0)
    rows, columns = (places[:, None] - places[None]).transpose(2, 0, 1) % PIXELS
    counts = albedo.sum()
    variance = np.abs(np.fft.fft2(_intensity_spectrum(albedo))) + counts
    r, q = albedo[albedo > 0.0], change[albedo > 0.0]
    found = []
    for one in expected:
        frame = both + rng.poisson(one - np.minimum(*expected))
        spectrum = np.fft.fft2(frame - frame.mean()) / variance
        pairs = spectrum[rows, columns]
        second = q @ (np.abs(pairs) ** 2 @ r)
        third = np.einsum("ij,ji->", q[:, None] * pairs * r, (pairs * r) @ pairs)
        found.append((second, third.real))
    return np.array(found)


def _intensity(field: np.ndarray) -> np.ndarray:
    """Return the counts (PIXELS, PIXELS) that a field on the object is expected to give."""
    return np.abs(np.fft.fft2(field, (PIXELS, PIXELS))) ** 2 / PIXELS**2


def _intensity_spectrum(albedo: np.ndarray) -> np.ndarray:
    """Return the squared modulus of the coherence, whose transform is r * r; (PIXELS, PIXELS)."""
    return np.abs(np.fft.ifft2(albedo, (PIXELS, PIXELS))) ** 2 * PIXELS**2


if __name__ == "__main__":
    main()
