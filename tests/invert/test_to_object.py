"""The speckle of the illumination stretches the paths of speckle by the closed form of `invert/tracking/to_object.py`."""

from __future__ import annotations

import numpy as np
import pytest

from correlograph.errors import InputError
from correlograph.files.capture import CameraMetadata, Capture
from invert.tracking.band import Band
from invert.tracking.to_object import ROUND_SPOT, metres_per_pixel, slope_variance, stretch_by_illumination
from invert.tracking.tracker import track
from tests.invert.field.speckle import letter, travelling_frames

PITCH_M = 5e-5
WAVELENGTH_M, SOURCE_M, SPOT_M = 532e-9, 0.5, 3e-3


def strokes() -> np.ndarray:
    """A letter whose strokes are of different brightness, 7 x 5 mm, neither symmetric nor square."""
    albedo = np.zeros((140, 100))
    albedo[:, 10:35], albedo[5:30, 10:95], albedo[60:80, 35:70] = 1.0, 0.7, 0.4
    return albedo


def illumination(shape: tuple[int, int], shift_m: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Field of a round rough spot on a grid that has moved by `shift_m`."""
    seats = (np.arange(len(source)) / (len(source) - 1) - 0.5) * SPOT_M
    turns = [
        np.exp(2j * np.pi / (WAVELENGTH_M * SOURCE_M) * np.outer(np.arange(side) * PITCH_M + shift, seats))
        for side, shift in zip(shape, shift_m, strict=True)
    ]
    return turns[0] @ source @ turns[1].T


def slope_of(change: np.ndarray) -> np.ndarray:
    """Return the slope (2,) of the phase, in radians per metre, that aligns all of `change` best: the maximum of its Fourier transform."""
    places = np.stack(np.meshgrid(*(PITCH_M * (np.arange(side) - side / 2) for side in change.shape), indexing="ij"), -1)
    slope = np.zeros(2)
    for _ in range(8):
        terms = change * np.exp(1j * places @ slope)
        whole, first = terms.sum(), 1j * (places * terms[..., None]).sum((0, 1))
        second = -np.einsum("ija,ijb,ij->ab", places, places, terms)
        curvature = (whole.conj() * second + np.outer(first.conj(), first)).real
        slope -= np.linalg.solve(curvature, (whole.conj() * first).real)
    return slope


def test_the_phase_of_a_small_way_has_the_slope_of_the_closed_form(rng):
    """A way of an eighth of a grain in a random direction, 1000 spots: mean squares and product of the slope along both axes.

    The closed form is that of grains much smaller than the strokes. Strokes are seven to fourteen grains wide here, and mean squares are
    12 % below it (5000 spots).
    """
    albedo, drawn = strokes(), []
    disc = np.hypot(*np.meshgrid(*(2 * [np.linspace(-1.0, 1.0, 144)]))) <= 1.0
    for _ in range(1000):
        source = disc * np.exp(2j * np.pi * rng.random(disc.shape))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        way = WAVELENGTH_M * SOURCE_M / SPOT_M / 8.0 * np.array([np.cos(angle), np.sin(angle)])
        before, after = (illumination(albedo.shape, shift, source) for shift in (np.zeros(2), way))
        drawn.append(slope_of(albedo * before.conj() * after) / np.linalg.norm(way))
    rows, columns = np.indices(albedo.shape).reshape(2, -1)
    expected = slope_variance(albedo.ravel(), PITCH_M * np.stack([rows, columns], 1), PITCH_M**2)
    found, scale = np.mean([np.outer(slope, slope) for slope in drawn], 0), expected.diagonal() ** 0.5
    scale = np.outer(scale, scale)
    np.testing.assert_allclose(found / scale, 0.88 * expected / scale, rtol=0.0, atol=0.15)  # chi^2 of 1000: 4.5 %


@pytest.mark.parametrize("binning", [1, 3])
def test_the_spectrum_of_the_speckle_gives_the_stretch(binning):
    """Frames of other pixels and other binning, of the same object, give the closed form for it in pixels of the frame."""
    albedo, distance, pitches = strokes(), 1.3, (6e-6, 7e-6)
    shape = (900 // binning, 1000 // binning)
    rows, columns = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    # A frequency f in cycles per pixel of pitch p belongs to lambda z f / p on the object.
    scale = [WAVELENGTH_M * distance / (pitch * binning) / PITCH_M for pitch in pitches]
    fine = np.fft.irfft2(np.abs(np.fft.rfft2(albedo, (512, 512))) ** 2, (512, 512))
    lags = [np.rint(scale[0] * rows).astype(int), np.rint(scale[1] * columns).astype(int)]
    seen = (np.abs(lags[0]) < 200)[:, None] & (np.abs(lags[1]) < 200)
    signal = np.where(seen, fine[np.ix_(lags[0] % 512, lags[1] % 512)], 0.0)
    counts = seen * np.where(np.arange(len(columns)) > 0, 2.0, 1.0)
    camera = CameraMetadata(WAVELENGTH_M, 6.5e-6, distance, row_pitch_m=pitches[0], column_pitch_m=pitches[1])
    found = stretch_by_illumination(Band(shape, rows, columns, counts, signal, 1.0, 1.0), camera, binning)
    spread = np.cov(np.indices(albedo.shape).reshape(2, -1), aweights=albedo.ravel(), ddof=0)
    area = albedo.sum() ** 2 / (albedo**2).sum()
    slope = (ROUND_SPOT / area * np.linalg.inv(spread).diagonal()) ** 0.5 / PITCH_M**2
    np.testing.assert_allclose(found, slope * WAVELENGTH_M * distance / (2.0 * np.pi) / pitches, rtol=0.03)


def test_a_camera_without_scale_is_refused():
    with pytest.raises(InputError, match="wavelength"):
        metres_per_pixel(CameraMetadata(), 0.5, (0.0, 0.0))


def test_each_of_two_objects_has_its_own_stretch():
    """A letter and a narrow bar move differently: the spectrum of their speckle together belongs to neither."""
    rng, shape, patch = np.random.default_rng(8), (520, 640), 128
    bar = np.zeros((24, 24))
    bar[9:14, 2:20] = 1.0
    albedos, numbers = (letter(), bar), np.arange(32)[:, None]
    paths = [numbers * np.array([1.1, -0.4]), numbers * np.array([-0.9, 0.8])]
    seen = [travelling_frames(one, shape, patch, rng, path, 40.0) for one, path in zip(albedos, paths, strict=True)]
    frames = [rng.poisson(0.5 * (0.55 * a + 0.45 * b)).astype(np.float32) for a, b in zip(*seen, strict=True)]
    camera = CameraMetadata(WAVELENGTH_M, 7e-6, 1.0)
    found = track(Capture(frames, camera=camera), source_distance_m=SOURCE_M)
    tracks = sorted((found, *found.others), key=lambda one: -one.step_pixels[0])
    assert len(tracks) == 2
    cell_m = WAVELENGTH_M / (7e-6 * patch)
    for one, albedo in zip(tracks, albedos, strict=True):
        rows, columns = np.indices(albedo.shape).reshape(2, -1)
        slope = slope_variance(albedo.ravel(), cell_m * np.stack([rows, columns], 1), cell_m**2).diagonal() ** 0.5
        np.testing.assert_allclose(one.stretch, slope * WAVELENGTH_M / (2.0 * np.pi * 7e-6), rtol=0.5)
        error = np.hypot(one.error_pixels, np.linalg.norm(one.path_m, axis=1)[:, None] * one.stretch)
        np.testing.assert_allclose(one.error_m, error * one.metres_per_pixel[0, 0])
