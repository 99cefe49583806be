"""Frames of a hidden object by an independent generator: scatterers at random positions, so that no lattice coincides with the solver's."""

from __future__ import annotations

import finufft
import numpy as np


def letter(side: int = 64, size: int = 20) -> np.ndarray:
    """Return an F of `size` pixels with a dimmer dot at its lower right, (side, side)."""
    albedo = np.zeros((side, side))
    top, left, width = (side - size) // 2, (side - size) // 2 + 2, max(2, size // 7)
    albedo[top : top + size, left : left + width] = 1.0
    albedo[top : top + width, left : left + size * 2 // 3] = 1.0
    albedo[top + size // 2 : top + size // 2 + width, left : left + size // 2] = 1.0
    albedo[top + size - width : top + size, left + size // 2 : left + size // 2 + width] = 0.6
    return albedo


def expected_frame(
    albedo: np.ndarray, shape: tuple[int, int], patch: int, rng: np.random.Generator, per_cell: int = 30
) -> np.ndarray:
    """Return the speckle intensity (rows, columns), mean about 1, of an albedo with one pixel per lag of a patch."""
    rows, columns = np.nonzero(albedo)
    count = per_cell * len(rows)
    chosen = rng.integers(0, len(rows), count)
    places = np.stack((rows[chosen], columns[chosen])) + rng.random((2, count)) - 0.5
    phases = np.sqrt(albedo[rows[chosen], columns[chosen]]) * np.exp(2j * np.pi * rng.random(count))
    turns = -2.0 * np.pi * (places - 0.5 * (albedo.shape[0] - 1)) / patch
    field = finufft.nufft2d1(turns[0], turns[1], phases, shape, eps=1e-6)
    intensity = np.abs(field) ** 2
    return intensity / (np.abs(phases) ** 2).sum()


def white(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Complex Gaussian numbers of variance 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / 2.0**0.5


def travelling_frames(
    albedo: np.ndarray, shape: tuple[int, int], patch: int, rng: np.random.Generator, path: np.ndarray, memory: float
) -> list[np.ndarray]:
    """Return the speckle (rows, columns), mean about 1, of an object whose speckle follows a path (frames, 2); see `travelling_fields`."""
    return [np.abs(field) ** 2 for field in travelling_fields(albedo, shape, patch, rng, path, memory)]


def travelling_fields(
    albedo: np.ndarray, shape: tuple[int, int], patch: int, rng: np.random.Generator, path: np.ndarray, memory: float
) -> list[np.ndarray]:
    """Return the field (rows, columns), mean intensity about 1, of an object whose speckle follows a path (frames, 2) in pixels. The
    illumination changes: fields of frames k apart correlate by exp(-k / memory)."""
    rows, columns = np.nonzero(albedo)
    chosen = rng.integers(0, len(rows), 30 * len(rows))
    places = np.stack((rows[chosen], columns[chosen])) + rng.random((2, len(chosen))) - 0.5
    turns = -2.0 * np.pi * (places - 0.5 * (albedo.shape[0] - 1)) / patch
    size, kept = np.sqrt(albedo[rows[chosen], columns[chosen]]), np.exp(-1.0 / memory)
    light, fields = np.zeros(len(chosen), complex), []
    for number, place in enumerate(path):
        fresh = (rng.standard_normal(len(chosen)) + 1j * rng.standard_normal(len(chosen))) / np.sqrt(2.0)
        light = kept * light + np.sqrt(1.0 - kept**2) * fresh if number else fresh
        field = finufft.nufft2d1(turns[0], turns[1], size * light * np.exp(-1j * (place @ turns)), shape, eps=1e-6)
        fields.append(field / np.sqrt((size**2).sum()))
    return fields


def fading_frames(
    rng: np.random.Generator, times: np.ndarray, step: np.ndarray, fading: float, light: float
) -> list[np.ndarray]:
    """Return frames (260, 300), with a mean of `light` photoelectrons, of speckle that travels by a step (2,) per unit of time, and whose
    intensities a time t apart correlate by exp(-fading t^2)."""
    sides = (320, 360)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * fading * (times[:, None] - times) ** 2))
    rows, columns = (np.fft.fftfreq(side) for side in sides)
    inside = (np.abs(rows[:, None]) < 0.12) & (np.abs(columns) < 0.07)
    fresh = rng.normal(size=(len(times), inside.sum())) + 1j * rng.normal(size=(len(times), inside.sum()))
    turn = (rows[:, None] * step[0] + columns * step[1])[inside]
    frames = []
    for when, amplitudes in zip(times, (vectors * np.sqrt(np.maximum(values, 0.0))) @ fresh, strict=True):
        field = np.zeros(sides, complex)
        field[inside] = amplitudes * np.exp(-2j * np.pi * when * turn)
        frames.append(np.abs(np.fft.ifft2(field))[:260, :300] ** 2)
    return [rng.poisson(light * one / np.mean(frames)).astype(np.float32) for one in frames]
