"""Lines in the spectrum of frames: fringes, lamp flicker and other periodic background.

The power spectrum of speckle is exponentially distributed. Its mean spectrum is smooth on the scale of one lag, which covers
several frequencies of the frame. A periodic pattern, static or moving from frame to frame, concentrates its power in one
frequency.
"""

from __future__ import annotations

import math

import torch
from torch.nn.functional import avg_pool2d, max_pool2d

from correlograph.lags import LAGS

MIN_PATCHES = 16
"""Minimum number of patches in a frame, so that a lag contains several frequencies."""

LINE = 30.0
"""Minimum power of a line in units of the mean around it; by chance once in e^30."""

_BLOCK = 8
"""Side of the blocks of the spectrum whose maximum is compared with the mean around them."""

_INNER, _OUTER = 3, 6
"""Half sides of the square that a line may fill and of the one around it that gives the background, in bins."""
_MAX_LINES = 100
"""Maximum number of lines; with more of them, the light is not periodic."""

Line = tuple[int, int]


def find_lines(power: torch.Tensor, per_lag: tuple[float, float], lags: int = LAGS) -> list[Line]:
    """Return the positions (row, column) of narrow peaks in the power spectrum (rows, columns // 2 + 1) of a zero-padded frame.

    Args:
        per_lag: frequency bins per lag, along rows and columns. Bins near zero frequency, which contain smooth light, are
            excluded.
        lags: largest lag.
    """
    down, right = (
        min(int((lags + 1) * each) // _BLOCK + 1, size // way // _BLOCK) * _BLOCK
        for each, size, way in zip(per_lag, power.shape, (2, 1), strict=True)
    )
    candidates = []
    for top in (0, power.shape[0] - down):  # the lags, positive and negative rows
        blocks = power[None, None, top : top + down, :right]
        mean = avg_pool2d(avg_pool2d(blocks, _BLOCK), 3, 1, 1, count_include_pad=False)
        found = torch.nonzero((max_pool2d(blocks, _BLOCK) > 0.5 * LINE * mean)[0, 0]) * _BLOCK
        candidates += [(top + row, column) for row, column in found.tolist()]
    lines = []
    for top, left in candidates if len(candidates) <= _MAX_LINES else ():
        row, column = divmod(int(power[top : top + _BLOCK, left : left + _BLOCK].argmax()), _BLOCK)
        line = top + row, left + column
        near_zero = min(line[0], power.shape[0] - line[0]) < 2.0 * per_lag[0] and line[1] < 2.0 * per_lag[1]
        places, level, _ = _around(power, line)
        strongest = float(power[line]) >= float(power[places].max())  # blocks may share a line
        if not near_zero and strongest and float(power[line]) > LINE * float(level):
            lines.append(line)
    return lines


def subtract_waves(image: torch.Tensor, lines: list[Line], padded: tuple[int, int]) -> torch.Tensor:
    """Subtract a sine wave per line from a frame (H, W), with fitted amplitude, phase and frequency."""
    for row, column in lines:
        frequency = [(row / padded[0] + 0.5) % 1.0 - 0.5, column / padded[1]]
        across = _wave(frequency[1], image.shape[1], image)
        for _ in range(2):
            frequency[0] = _strongest(torch.complex(image @ across.real, image @ across.imag), frequency[0])
            down = _wave(frequency[0], image.shape[0], image)
            frequency[1] = _strongest(torch.complex(down.real @ image, down.imag @ image), frequency[1])
            across = _wave(frequency[1], image.shape[1], image)
        amplitude = (torch.complex(down.real @ image, down.imag @ image) * across).sum() * (2.0 / image.numel())
        image = image - ((amplitude * down.conj())[:, None] * across.conj()).real
    return image


def lower_lines(spectrum: torch.Tensor, power: torch.Tensor, lines: list[Line]) -> None:
    """Reduce what is left of subtracted waves in the spectrum of a frame to the level of the neighbouring frequencies, in place."""
    for line in lines:
        (rows, columns), level, inner = _around(power, line)
        around = power[rows, columns]
        scale = torch.where(inner & (around > level), (level / around.clamp_min(1e-30)).sqrt(), torch.ones_like(around))
        spectrum[rows, columns] *= scale
        power[rows, columns] *= scale.square()


def _around(power: torch.Tensor, line: Line) -> tuple[tuple[torch.Tensor, torch.Tensor], torch.Tensor, torch.Tensor]:
    """Return the indices of the frequencies around a line, the mean power of the outer ones, and a mask of the inner ones."""
    apart = torch.arange(-_OUTER, _OUTER + 1, device=power.device)
    columns = line[1] + apart
    columns = columns[(columns >= 0) & (columns < power.shape[1])]
    places = ((line[0] + apart) % power.shape[0])[:, None], columns
    inner = (apart.abs() <= _INNER)[:, None] & ((columns - line[1]).abs() <= _INNER)
    return places, power[places][~inner].mean(), inner


def _wave(frequency: float, length: int, like: torch.Tensor) -> torch.Tensor:
    """Return exp(-2 pi i f x), complex64 (length,)."""
    phase = (-2.0 * math.pi * frequency) * torch.arange(length, dtype=torch.float64)
    return torch.polar(torch.ones_like(phase), phase).to(device=like.device, dtype=torch.complex64)


def _strongest(signal: torch.Tensor, frequency: float) -> float:
    """Return the frequency near a given one at which the transform of a signal (length,) has its maximum."""
    step = 0.3 / len(signal)
    for _ in range(3):
        places = (frequency - step, frequency, frequency + step)
        before, here, after = (math.log(float((signal * _wave(f, len(signal), signal)).sum().abs()) + 1e-30) for f in places)
        bend = before - 2.0 * here + after
        if bend < 0.0:
            frequency += step * max(-1.0, min(1.0, 0.5 * (before - after) / bend))
        step *= 0.5
    return frequency
