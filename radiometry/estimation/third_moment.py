"""Third moment of filtered frames, which distinguishes speckle of an object from other light.

Speckle is the squared modulus of a circular Gaussian field. The spectrum A of a frame therefore has a third moment, which is the
triple correlation of the albedo r: E[A(a) A(b) A(-a-b)] = T(a, b) + T(-a, -b) (Lohmann, Weigelt and Wirnitzer,
doi:10.1364/AO.22.004028). Texture, gradients and fringes with the same power spectrum have no third moment, or a different one.
Frames are filtered to J = w A, where w is the fraction of signal at each lag. The mean of J^3 is compared with that of a candidate,

    E[J^3] = 2 sum over x, y, z of r_x r_y r_z w(y - x) w(z - y) w(x - z) = 2 tr((D M)^3),   D = diag(r),  M_xy = w(x - y),

while E[J^2] is the sum over lags of w^2 (r*r). The contribution of shot noise is subtracted. It follows from the gain of the
camera (`radiometry.estimation.photon_transfer`), not from the noise floor, because read noise has no third moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.fft import next_fast_len
from scipy.stats import f as f_distribution

from correlograph.lags import LAGS, lag_grid_of
from radiometry.autocorrelation import autocorrelate
from radiometry.estimation.excess_scatter import ExcessScatter
from radiometry.estimation.masked import BLOCKS, Kept
from radiometry.estimation.photon_transfer import PhotonTransfer, shot_noise

MIN_SIGNAL_FRACTION = 0.2
"""Minimum fraction of signal in a lag that is used."""

FINE_LAGS = 4
"""Points per lag with which sums over lags are compared."""

MAX_SCATTER = 4.0
"""Maximum variance of the power of blocks of speckle, in units of that of a Gaussian of the same spectrum."""

MAX_EXACT_CELLS, TRACE_VECTORS = 3000, 48
"""Number of bright cells up to which the expected third moment is exact, and number of vectors that estimate it for more."""

MAX_FRAMES = 8
"""Maximum number of frames whose spectra are kept."""


def narrow(spectrum: torch.Tensor, padded: tuple[int, int], patch: tuple[int, int], lags: int = LAGS) -> torch.Tensor:
    """Crop the spectrum (rows, columns // 2 + 1) of a padded frame to the lags: an odd number of rows, in FFT order (zero
    first, negative last), and the columns from zero on.
    """
    rows, columns = (min(int((lags + 1) * side / size), side // 2 - 1) for side, size in zip(padded, patch, strict=True))
    return torch.cat((spectrum[: rows + 1, : columns + 1], spectrum[-rows:, : columns + 1]))


@dataclass(frozen=True)
class FilteredFrames:
    """Frames, band-limited to the lags.

    Attributes:
        spectra: spectrum of each frame from `narrow`, complex64 (rows, columns).
        padded, frame, patch: (rows, columns) in pixels of the zero-padded frame, of the frame and of a patch.
        level: mean of the frames.
        noise: noise of the pixels.
        lags: largest lag.
        kept: statistics of the mask; None without one.
        gain: mean factor of the spectra, which gave all frames the same light.
        noise_gain: mean of the factor's cube times the light, over the mean light: that of the third moment of shot noise alone.
    """

    spectra: tuple[torch.Tensor, ...]
    padded: tuple[int, int]
    frame: tuple[int, int]
    patch: tuple[int, int]
    level: float
    noise: PhotonTransfer
    lags: int = LAGS
    kept: Kept | None = None
    gain: float = 1.0
    noise_gain: float = 1.0

    def likeness(
        self, albedo: np.ndarray, weight: np.ndarray, amplitude: np.ndarray, signal: np.ndarray, floor: float, power: float
    ) -> tuple[float, float]:
        """Return the ratio of the measured third moment to that expected of speckle from an albedo (64, 64), and the
        standard error of the ratio. What the sums over lags deviate from integrals by counts as an error.

        Args:
            weight: w (127, 127). amplitude: amplitude transfer of the camera, the root of H (127, 127).
            signal, floor: signal and noise floor of the estimate before division by H. power: factor that converts r*r of
                the albedo to the unit of the estimate.
        """
        pixels, noise = math.prod(self.patch), shot_noise(self.noise, self.level, floor)
        measured, error = self.third_moment(weight)
        by_noise = shot_noise_part(weight, self.gain * signal, self.noise_gain * noise.variance, pixels)
        measured, error = measured - noise.gain * by_noise, math.hypot(error, noise.error * by_noise)
        expected = expected_third_moment(albedo, weight * amplitude, power, pixels)
        error = math.hypot(error, error_of_sums(weight) * (expected + noise.gain * by_noise))
        return (measured / expected, error / expected) if expected > 0.0 else (0.0, np.inf)

    def third_moment(self, weight: np.ndarray) -> tuple[float, float]:
        """Return the mean of J^3 over frames, in frame units cubed, and its standard error.

        Args:
            weight: w (n, n), even, zero lag in the middle.
        """
        every = self._block_means(weight, 3)
        if self.kept is not None:
            every = every[:, torch.from_numpy(self.kept.is_used).to(every.device)]
        every = every.flatten()
        return float(every.mean()), float(every.std() / len(every) ** 0.5)

    def power_differences(
        self, weight: np.ndarray, lags: np.ndarray, signal: np.ndarray, albedo: np.ndarray
    ) -> ExcessScatter | None:
        """Return the scatter of the mean of J^2 between parts of a frame; None without signal, and if a mask empties blocks.

        A frame has 8 x 8 blocks, and a part is 2 x 2 of them. Speckle has the same statistics everywhere, so parts differ no
        more than expected from the blocks within them (analysis of variance) or from the spectrum: the power of a Gaussian J
        over an area A has the relative variance (2 sum P^2 / (sum P)^2) (a / A), with P = w^2 S and a the area of a patch. The
        larger expectation is used, but at most `MAX_SCATTER`
        times that from the spectrum: blocks that differ by more, as by a specular highlight, are not speckle. Speckle of few small
        points varies little within a block, but from part to part: its power goes with the square of the light of a part, whose
        variance follows from the albedo (`light_variance`).

        Args:
            weight: w (127, 127). lags: the estimate S (127, 127). signal: S without its floor. albedo: a reconstruction (64, 64).
        """
        if self.kept is not None and not self.kept.is_used.all():
            return None
        power = self._block_means(weight, 2)
        power = power / power.mean((1, 2), keepdim=True).clamp_min(1e-300)
        parts = power.reshape(len(power), BLOCKS // 2, 2, BLOCKS // 2, 2).transpose(2, 3).flatten(3)
        means = parts.mean(3)
        count = math.prod(means.shape[1:])
        between = 4.0 * float(((means - 1.0) ** 2).sum()) / (len(power) * (count - 1))
        within = float(((parts - means[..., None]) ** 2).sum()) / (len(power) * count * 3)
        spectrum = weight**2 * lags.astype(np.float64)
        share = 2.0 * float((spectrum**2).sum()) / max(float(spectrum.sum()) ** 2, 1e-300)
        expected = 4.0 * share * count * math.prod(self.patch) / math.prod(self.frame)
        of_signal = float((weight**2 * signal).sum()) / max(float(spectrum.sum()), 1e-300)
        by_light = 4.0 * (2.0 * of_signal) ** 2 * light_variance(albedo, self.patch, tuple(side // 4 for side in self.frame))
        within = max(min(max(within, expected), MAX_SCATTER * expected), by_light)
        if within <= 0.0:
            return None
        null = f_distribution(len(power) * (count - 1), len(power) * count * 3)
        return ExcessScatter.of(between / 4.0, within / 4.0, null)

    def _block_means(self, weight: np.ndarray, exponent: int) -> torch.Tensor:
        """Return the mean of J to a power (`exponent`) in each block of each frame, (frames, 8, 8); the scatter of the
        blocks gives standard errors.

        J is sampled at three times its highest frequency, so that its cube has no alias at zero frequency.
        """
        steps = [size / side for size, side in zip(self.patch, self.padded, strict=True)]
        reach = [int(np.abs(np.argwhere(weight)[:, axis] - self.lags).max()) + 1 for axis in (0, 1)]
        sides = [
            min(next_fast_len(int(3 * far / step) + 2, real=True), side)
            for far, step, side in zip(reach, steps, self.padded, strict=True)
        ]
        height, width = self.spectra[0].shape
        lag_rows, lag_columns = np.fft.fftfreq(height, 1.0 / height) * steps[0], np.arange(width) * steps[1]
        rows, columns = np.flatnonzero(np.abs(lag_rows) < reach[0]), np.flatnonzero(lag_columns < reach[1])
        down, right = _between_lags(lag_rows[rows], self.lags), _between_lags(lag_columns[columns], self.lags)
        device = self.spectra[0].device
        fine = torch.from_numpy(down @ weight.astype(np.float32) @ right.T).to(device)
        fine *= math.prod(sides) / math.prod(self.padded)
        kept, ahead = torch.from_numpy(rows).to(device), int((lag_rows[rows] >= 0.0).sum())
        blocks = [int(side * full / whole) // BLOCKS for side, full, whole in zip(sides, self.frame, self.padded, strict=True)]
        means = []
        for values in self.spectra:
            seen = values[kept, : len(columns)] * fine
            spectrum = torch.zeros((sides[0], sides[1] // 2 + 1), dtype=torch.complex64, device=device)
            spectrum[:ahead, : len(columns)] = seen[:ahead]
            spectrum[sides[0] - len(seen) + ahead :, : len(columns)] = seen[ahead:]
            filtered = torch.fft.irfft2(spectrum, s=sides)[: blocks[0] * BLOCKS, : blocks[1] * BLOCKS] ** exponent
            means.append(filtered.reshape(BLOCKS, blocks[0], BLOCKS, blocks[1]).double().mean((1, 3)))
        every = torch.stack(means)
        return every if self.kept is None else every / torch.from_numpy(self.kept.blocks[exponent]).to(device)


def shot_noise_part(weight: np.ndarray, signal: np.ndarray, variance: float, patch_pixels: int) -> Any:
    """Return the contribution of shot noise to the mean of J^3 for a gain of 1, in frame units squared.

    Args:
        weight: w (127, 127). signal: of the estimate; leading axes (..., 127, 127) are those of the result.
        variance: variance of the shot noise per pixel. patch_pixels: pixels per patch.
    """
    lags = lag_grid_of(weight).lags
    pairs = autocorrelate(weight)[lags:-lags, lags:-lags]
    return (weight * pairs * (3.0 * signal + variance)).sum((-2, -1)) / patch_pixels**2


def error_of_sums(weight: np.ndarray) -> float:
    """Return the relative deviation of the sum over lags of the triple product w(a) w(b) w(a + b) of a filter (n, n) from its integral.

    Between lags, the filter is interpolated linearly, as in frames. It is small unless few lags are left, such as a thin ring.
    """
    lags = lag_grid_of(weight).lags
    reach = int(np.abs(np.argwhere(weight) - lags).max(initial=0)) + 1
    between = _between_lags(np.arange(-FINE_LAGS * reach, FINE_LAGS * reach + 1) / FINE_LAGS, lags)

    def triples(values: np.ndarray) -> float:
        side = len(values) // 2
        return float((values * autocorrelate(values)[side:-side, side:-side]).sum())

    whole = slice(lags - min(reach, lags), lags + min(reach, lags) + 1)
    at_lags = triples(weight[whole, whole])
    return abs(triples(between @ weight @ between.T) / FINE_LAGS**4 / at_lags - 1.0) if at_lags > 0.0 else math.inf


def light_variance(albedo: np.ndarray, patch: tuple[int, int], area: tuple[int, int]) -> float:
    """Return the relative variance of the light of speckle from an albedo on an area of a frame (rows, columns in pixels): the sum of r*r,
    times the power spectrum of the area, over the sum of r*r."""
    values = autocorrelate(albedo).astype(np.float64)
    steps = lag_grid_of(values).steps
    rows, columns = (np.sinc(steps * side / size) ** 2 for side, size in zip(area, patch, strict=True))
    return float(rows @ values @ columns / max(values.sum(), 1e-300))


def expected_third_moment(albedo: np.ndarray, weight: np.ndarray, power: float, patch_pixels: int) -> float:
    """Return E[J^3] of speckle from an albedo (64, 64) whose r*r is multiplied by `power`."""
    cells = np.argwhere(albedo > 0.02 * albedo.max())
    if len(cells) > MAX_EXACT_CELLS:
        return 2.0 * (power / patch_pixels) ** 1.5 * _estimated_trace(albedo, weight)
    shown = torch.from_numpy(albedo[tuple(cells.T)].astype(np.float32)).sqrt()
    apart = cells[:, None] - cells[None] + lag_grid_of(weight).lags
    matrix = shown[:, None] * torch.from_numpy(weight.astype(np.float32)[apart[..., 0], apart[..., 1]]) * shown
    return 2.0 * float((power / patch_pixels) ** 1.5 * ((matrix @ matrix) * matrix).sum(dtype=torch.float64))


def _estimated_trace(albedo: np.ndarray, weight: np.ndarray) -> float:
    """Return an estimate of tr((D M)^3) for many cells by Hutch++ (Meyer, Musco, Musco and Woodruff, doi:10.1137/1.9781611976496.16).

    The trace is exact on the space of the largest eigenvalues; random vectors of a fixed seed estimate the rest. D^1/2 M D^1/2 is
    applied by FFTs.
    """
    grid = lag_grid_of(weight)
    root, side = torch.from_numpy(albedo.clip(0.0)).float().sqrt(), next_fast_len(len(albedo) + grid.lags, real=True)
    on_circle = np.zeros((side, side), np.float32)
    inside = np.abs(grid.steps) < min(len(albedo), grid.lags + 1)
    places = grid.steps[inside] % side
    on_circle[places[:, None], places] = weight[np.ix_(inside, inside)]
    transfer = torch.fft.rfft2(torch.from_numpy(on_circle))

    def apply(vectors: torch.Tensor) -> torch.Tensor:
        images = vectors.T.reshape(-1, *root.shape) * root
        parts = (torch.fft.irfft2(torch.fft.rfft2(part, s=(side, side)) * transfer, s=(side, side)) for part in images.split(8))
        seen = torch.cat([part[:, : len(root), : len(root)] for part in parts])
        return (seen * root).reshape(len(images), -1).T

    signs = torch.randint(2, (2, root.numel(), TRACE_VECTORS), generator=torch.Generator().manual_seed(0)).float() * 2.0 - 1.0
    space = torch.linalg.qr(apply(signs[0]))[0]
    rest = signs[1] - space @ (space.T @ signs[1])
    exact, other = apply(space), apply(rest)
    return float(
        (exact * apply(exact)).sum(dtype=torch.float64) + (other * apply(other)).sum(dtype=torch.float64) / TRACE_VECTORS
    )


@dataclass(frozen=True)
class PatchLight:
    """Light of a patch.

    Attributes:
        peak: (r*r)(0) in photoelectrons squared.
        white: photoelectrons per pixel of other light.
        read: variance of the read noise.
        polarisations: number of incoherent patterns that share the light.
    """

    peak: float
    white: float = 0.0
    read: float = 0.0
    polarisations: int = 1


def drawn_third_moment(
    albedo: np.ndarray, weight: np.ndarray, transfer: np.ndarray, patch_pixels: int, light: PatchLight, draws: int = 200
) -> tuple[float, float]:
    """Return the mean of J^3 over a patch without shot noise, in photoelectrons cubed, and its standard deviation between patches.

    Speckle is skewed and its cube is far from Gaussian. Patches are therefore simulated on the coarsest grid of pixels that
    holds their lags. The part of the deviation that is proportional to the power of a patch is excluded, because it cancels
    when a moment is compared with that of a reconstruction of the same power.

    Args:
        albedo: (64, 64), one cell per lag. weight: w (127, 127). transfer: H (127, 127).
        patch_pixels: pixels per patch.
    """
    lags = lag_grid_of(weight)
    side = lags.padded_side
    pixels, rng = side * side, torch.Generator().manual_seed(0)
    binned = patch_pixels / pixels
    peak, white, read = binned * light.peak, binned * light.white, binned * light.read
    polarisations = light.polarisations
    root = torch.from_numpy(albedo * math.sqrt(peak / (4.0 * pixels * polarisations * float(np.square(albedo).sum())))).sqrt()
    parts = torch.randn(2, draws, polarisations, *albedo.shape, generator=rng)
    fields = torch.complex(root.float() * parts[0], root.float() * parts[1])
    speckle = torch.fft.fft2(fields, s=(side, side)).abs().square().sum(1)
    places = torch.from_numpy(lags.steps) % side
    through, seen = torch.ones(side, side), torch.zeros(side, side)
    through[places[:, None], places] = torch.from_numpy(np.sqrt(transfer).astype(np.float32))
    seen[places[:, None], places] = torch.from_numpy(weight.astype(np.float32))
    blurred = torch.fft.ifft2(torch.fft.fft2(speckle) * through).real.clamp_min(0.0)
    level = float(blurred.mean()) + white
    counts = torch.poisson(blurred + white, generator=rng) + math.sqrt(read) * torch.randn(blurred.shape, generator=rng)
    spectra = torch.fft.fft2(counts - level)
    cubes = (torch.fft.ifft2(spectra * seen).real.double() ** 3).mean((1, 2)).numpy()
    powers = (spectra.abs().square() / pixels)[:, places[:, None], places].double().numpy() - (level + read)
    moments = cubes - shot_noise_part(weight, powers, level, pixels)
    strength = (weight**2 * powers).sum((1, 2))
    slope = 1.5 * moments.mean() / strength.mean()
    return float(moments.mean()) / binned**3, float((moments - slope * strength).std(ddof=1)) / binned**3


def _between_lags(lags: np.ndarray, largest: int) -> np.ndarray:
    """Return the matrix (len(lags), 2 largest + 1) that interpolates linearly from whole lags to fractional `lags`; zero beyond."""
    return np.clip(1.0 - np.abs(lags[:, None] - np.arange(-largest, largest + 1)), 0.0, None).astype(np.float32)
