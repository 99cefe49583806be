"""Periodic motion in a path: maxima of its spectrum above the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import detrend

FALSE_ALARM = 0.01
"""Probability that a path without vibration shows one."""

MAX_VIBRATIONS = 5


@dataclass(frozen=True)
class Vibration:
    """One periodic motion: frequency in periods per frame, amplitude in pixels (rows, columns), and its false-alarm probability."""

    periods_per_frame: float
    amplitude_pixels: tuple[float, float]
    false_alarm: float


def find_vibrations(path: np.ndarray) -> list[Vibration]:
    """Return the vibrations of a path (frames, 2), the strongest first.

    The sum of the powers of both axes is compared with the median of its neighbours.
    """
    frames = len(path)
    if frames < 16:
        return []
    window = np.hanning(frames + 2)[1:-1]
    spectrum = np.fft.rfft(detrend(path, axis=0) * window[:, None], axis=0)[2:-1]
    power = (np.abs(spectrum) ** 2).sum(1)
    half = max(8, len(power) // 16)
    noise = np.array([np.median(power[max(0, one - half) : one + half + 1]) for one in range(len(power))])
    # Sum of two exponential powers: a Gamma variable of shape 2, with median 1.678 in units of the mean of one.
    ratio = power / np.maximum(noise / 1.678, 1e-300)
    chance = np.minimum(1.0, len(power) * (1.0 + ratio) * np.exp(-np.minimum(ratio, 700.0)))
    found = []
    for place in np.argsort(-ratio):
        if chance[place] > FALSE_ALARM or len(found) == MAX_VIBRATIONS:
            break
        if all(abs(place - other) > 3 for other, _ in found):
            found.append((place, chance[place]))
    return [
        Vibration((place + 2) / frames, tuple((2.0 * np.abs(spectrum[place]) / window.sum()).tolist()), float(rate))
        for place, rate in found
    ]
