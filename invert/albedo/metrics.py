"""Scores of a reconstruction: against a known truth after registration or, without one, against the estimate."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy import ndimage
from scipy.stats import bootstrap
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from skimage.registration import phase_cross_correlation

from correlograph.errors import InputError
from correlograph.lags import lag_grid_of
from invert.albedo.registration import on_grid, register_images
from radiometry.autocorrelation import autocorrelate, smooth_by_window

SUCCESS = 0.8
"""Registered Pearson correlation of a successful reconstruction."""


PERFECT_DB = 300.0
"""PSNR of an exact match."""


@dataclass(frozen=True)
class Scores:
    """Scores of one reconstruction, registered to the truth and scaled to its brightness by least squares.

    Attributes:
        pearson: correlation over the window of the truth.
        ssim: structural similarity (Wang et al., doi:10.1109/TIP.2003.819861), Gaussian window of 1.5 pixels.
        psnr_db: peak signal-to-noise ratio; the peak is that of the truth.
        iou: intersection over union of the truth's pixels above half of its maximum and an equal number of the brightest
            pixels of the image.
        edge_f1: F1 score of the outlines of these two sets of pixels, where outlines up to one pixel apart match.
        success: whether the correlation reaches `SUCCESS`.
    """

    pearson: float
    ssim: float
    psnr_db: float
    iou: float
    edge_f1: float
    success: bool

    def as_dict(self) -> dict[str, float | bool]:
        return asdict(self)


def aligned_pearson(image: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the Pearson correlation after the best whole-pixel shift and rotation by 180 degrees (no mirroring).

    Both images are zero-padded to twice their size for the search, so nothing wraps around.

    Returns:
        the correlation over the window of the truth, and the registered image.

    Raises InputError for images that are not finite numbers of one shape (height, width).
    """
    _check_pair(image, truth)
    image, truth = np.asarray(image), np.asarray(truth)
    moved = register_images(on_grid(image)[None], on_grid(truth))[0][0, : truth.shape[0], : truth.shape[1]].numpy()
    return _pearson(moved, truth), moved


def register_subpixel(image: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray]:
    """Register like `aligned_pearson`, then by a fraction of a pixel if that correlates better."""
    pearson, moved = aligned_pearson(image, truth)
    if pearson == 0.0:
        return pearson, moved
    shift = phase_cross_correlation(truth, moved, upsample_factor=10, normalization=None)[0]
    finer = ndimage.shift(moved, np.clip(shift, -1.0, 1.0), order=3)
    better = _pearson(finer, truth)
    return (better, finer) if better > pearson else (pearson, moved)


def score(image: np.ndarray, truth: np.ndarray) -> Scores:
    """Score a reconstruction (64, 64) against the truth (64, 64); an empty image scores zero.

    Raises InputError for images that are not finite numbers of one shape, and for a truth without contrast.
    """
    _check_pair(image, truth)
    image, truth = np.asarray(image), np.asarray(truth)
    if np.ptp(truth) == 0.0:
        raise InputError("truth", "an image with contrast", "the same value everywhere", "use another truth")
    pearson, moved = register_subpixel(image.astype(np.float64), truth.astype(np.float64))
    peak = float(truth.max())
    fitted = moved * float((moved * truth).sum() / max((moved * moved).sum(), 1e-30))
    ssim = structural_similarity(
        fitted, truth.astype(np.float64), data_range=peak, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    with np.errstate(divide="ignore"):
        psnr_db = float(peak_signal_noise_ratio(truth.astype(np.float64), fitted, data_range=peak))
    shown = truth > 0.5 * peak
    drawn = _brightest(fitted, int(shown.sum()))
    return Scores(
        pearson, float(ssim), min(psnr_db, PERFECT_DB), _iou(drawn, shown), _edge_f1(drawn, shown), pearson >= SUCCESS
    )


def _check_pair(image: np.ndarray, truth: np.ndarray) -> None:
    if any(np.asarray(one).dtype.kind not in "fiub" for one in (image, truth)):
        raise InputError("image and truth", "arrays of real numbers", f"{type(image).__name__}", "convert them")
    shapes = np.shape(image), np.shape(truth)
    if shapes[0] != shapes[1] or len(shapes[0]) != 2 or 0 in shapes[0]:
        raise InputError("image and truth", "two images of one shape", f"{shapes[0]} and {shapes[1]}", "resample one of them")
    if not (np.isfinite(image).all() and np.isfinite(truth).all()):
        raise InputError("image and truth", "finite numbers", "NaN or infinity", "correct the images")


def _pearson(image: np.ndarray, truth: np.ndarray) -> float:
    if np.ptp(image) == 0.0 or np.ptp(truth) == 0.0:
        return 0.0
    return float(np.corrcoef(image.ravel(), truth.ravel())[0, 1])


def _brightest(image: np.ndarray, count: int) -> np.ndarray:
    """Return a mask of the `count` brightest pixels above zero, bool."""
    chosen = np.zeros(image.size, bool)
    chosen[np.argsort(-image.ravel(), kind="stable")[:count]] = True
    return chosen.reshape(image.shape) & (image > 0.0)


def _iou(drawn: np.ndarray, shown: np.ndarray) -> float:
    return float((drawn & shown).sum() / (drawn | shown).sum())


def _edge_f1(drawn: np.ndarray, shown: np.ndarray) -> float:
    ours, theirs = drawn & ~ndimage.binary_erosion(drawn), shown & ~ndimage.binary_erosion(shown)
    if not ours.any():
        return 0.0
    near = np.ones((3, 3), bool)
    precision = float(ndimage.binary_dilation(theirs, near)[ours].mean())
    recall = float(ndimage.binary_dilation(ours, near)[theirs].mean())
    return 2.0 * precision * recall / (precision + recall) if precision + recall else 0.0


def agreement(albedo: np.ndarray, estimate: np.ndarray, floor: float, signal_ring: int) -> float:
    """Return the Pearson correlation of the reconstruction's autocorrelation with the estimate, over the lags with signal.

    A high value shows that a reconstruction explains the data, not that it is right: a bright point with a faint copy of the object
    explains them too.
    """
    grid = lag_grid_of(estimate)
    used = grid.half_plane & (signal_ring >= grid.ring) & (np.hypot(grid.row, grid.column) > 1.5)
    return _pearson(smooth_by_window(autocorrelate(albedo))[used], (estimate - floor)[used])


def bootstrap_error(values: np.ndarray, resamples: int = 2000, seed: int = 0) -> float:
    """Return the standard error of a mean over test images by bootstrap (Efron, doi:10.1214/aos/1176344552)."""
    found = bootstrap(
        (np.asarray(values, np.float64),), np.mean, n_resamples=resamples, method="percentile", rng=np.random.default_rng(seed)
    )
    return float(found.standard_error)
