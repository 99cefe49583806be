"""Light on the wall, drawn without the simulator: speckle of any object, and the texture of a wall."""

import numpy as np

from data_gen.letters import letter


def letter_cells(character: str) -> np.ndarray:
    """A letter 32 lags high in the middle of (64, 64), 0 to 1."""
    return np.pad(letter(character).reshape(32, 8, 32, 8).mean((1, 3)) / 255.0, 16)


def speckle(amplitude: np.ndarray, period: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Intensity of fully developed speckle, mean 1: |FFT|^2 of random phasors of these amplitudes, padded to a period."""
    field = amplitude * (rng.standard_normal((*amplitude.shape, 2)) @ (1.0, 1.0j))
    light = np.abs(np.fft.fft2(field, s=period)) ** 2
    return light / light.mean()


def thrown(cells: np.ndarray, shape: tuple[int, int], patch: int, rng: np.random.Generator) -> np.ndarray:
    """Intensity that an albedo (64, 64), a lag a cell, throws: |FFT|^2 of its field on a period a fifth wider than `shape`."""
    places = [np.fft.fftfreq(round(1.2 * side)) * patch + 32.0 for side in shape]
    inside = [np.flatnonzero((place >= 0.0) & (place < 64.0)) for place in places]
    shown = cells[np.ix_(*(place[own].astype(int) for place, own in zip(places, inside, strict=True)))]
    amplitude = np.zeros([len(place) for place in places])
    amplitude[np.ix_(*inside)] = np.sqrt(shown)
    return speckle(amplitude, amplitude.shape, rng)


def wall_texture(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Mean 0, deviation 1, its power falling with the square of the frequency."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    frequency[0, 0] = np.inf
    drawn = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) / frequency, s=shape)
    return drawn / drawn.std()
