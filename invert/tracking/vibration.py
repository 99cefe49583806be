"""Periodic motion in a path: maxima of its spectrum above the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2
from scipy.stats import f as f_distribution

FALSE_ALARM = 0.01
"""Probability that a path without vibration shows one."""

MAX_VIBRATIONS = 5
STEPS = 32
"""Steps from one frequency of the spectrum to the next in which a maximum is sought."""

LOBE = 1
"""Frequencies on each side of a maximum that the window gives a part of its power."""

BENDS = 7
"""Degree of the polynomial that is subtracted from a path; it has fewer periods than any vibration that is sought."""

SHARED_BY_WINDOW = 35.0 / 18.0
"""Factor by which the window raises the variance of a mean of neighbouring powers: 1 + 2 (2/3)^2 + 2 (1/6)^2."""

MIN_SIDE_FREQUENCIES = 4
"""Least number of frequencies on a side with which a maximum is compared."""


@dataclass(frozen=True)
class Vibration:
    """One periodic motion.

    Attributes:
        periods_per_frame: frequency.
        phasor_pixels: complex amplitude along rows and columns, (2,); its phase tells whether both axes move together.
        false_alarm: probability that noise looks like this.
    """

    periods_per_frame: float
    phasor_pixels: np.ndarray
    false_alarm: float

    @property
    def amplitude_pixels(self) -> tuple[float, float]:
        rows, columns = np.abs(self.phasor_pixels)
        return float(rows), float(columns)


def find_vibrations(path: np.ndarray) -> list[Vibration]:
    """Return the vibrations of a path (frames, 2), the strongest first.

    A vibration stands above its neighbours on both sides: the spectrum of a curved path, and that of errors that add up along it, falls
    with frequency.
    """
    frames = len(path)
    if frames < 2 * BENDS:
        return []
    window = np.hanning(frames + 2)[1:-1]
    times = np.linspace(-1.0, 1.0, frames)
    bent = legendre.legval(times, legendre.legfit(times, path, BENDS)).T
    straight = (path - bent) * window[:, None]
    spectrum = np.fft.rfft(straight, axis=0)[2:-1]
    power, free, found = np.abs(spectrum) ** 2, np.ones(len(spectrum), bool), []
    while len(found) < MAX_VIBRATIONS:
        chance = len(power) * np.array([_chance(power, free, place) for place in range(len(power))])
        if chance.min() > FALSE_ALARM:
            break
        place = int(np.where(chance <= FALSE_ALARM, power.sum(1), 0.0).argmax())
        frequency, values = _maximum(straight, (place + 2) / frames)
        found.append(Vibration(frequency, 2.0 * values / window.sum(), float(chance[place])))
        free[max(0, place - 2 * LOBE) : place + 2 * LOBE + 1] = False
    return found


def _maximum(straight: np.ndarray, frequency: float) -> tuple[float, np.ndarray]:
    """Return the frequency near a given one at which the spectrum of a windowed path (frames, 2) is highest, below one half, and the
    spectrum there, complex (2,)."""
    frames = len(straight)
    near = np.minimum(frequency + np.linspace(-1.0, 1.0, 2 * STEPS + 1) / frames, 0.5 - 0.5 / frames)
    values = np.exp(-2j * np.pi * np.outer(near, np.arange(frames))) @ straight
    best = int((np.abs(values) ** 2).sum(1).argmax())
    return float(near[best]), values[best]


def _chance(power: np.ndarray, free: np.ndarray, place: int) -> float:
    """Return the probability that noise exceeds its level by as much as the power at a frequency; 1 if too few lie below it.

    The level is the larger of those below and above, from medians, which other vibrations hardly raise; at the highest frequencies, it is
    that below. The axes are independent: their probabilities are combined by Fisher's method.

    Args:
        power: (frequencies, 2). free: frequencies that belong to no vibration found before.
    """
    reach = max(3 * MIN_SIDE_FREQUENCIES, len(power) // 16)
    sides = np.s_[max(0, place - LOBE - reach) : max(0, place - LOBE)], np.s_[place + LOBE + 1 : place + LOBE + 1 + reach]
    below, above = (power[one][free[one]] for one in sides)
    if not free[place] or len(below) < MIN_SIDE_FREQUENCIES:
        return 1.0
    used = [below, above] if len(above) >= MIN_SIDE_FREQUENCIES else [below]
    noise, count = np.max([np.median(one, 0) for one in used], 0) / np.log(2.0), sum(len(one) for one in used)
    if len(used) == 1:  # a median varies as much as the mean of half as many
        count *= np.log(2.0) ** 2
    each = f_distribution.sf(power[place] / np.maximum(noise, 1e-300), 2, 2 * count / SHARED_BY_WINDOW)
    return float(chi2.sf(-2.0 * np.log(np.maximum(each, 1e-300)).sum(), 4))
