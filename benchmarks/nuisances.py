"""`python -m benchmarks.nuisances [-o out/nuisances]`: what cameras and walls do to frames, one by one and in pairs.

Frames are made here, by code that shares nothing with `sim`: circular Gaussian amplitudes on the object's cells, one FFT,
squared, Poisson noise. For every nuisance and 1, 2 and 10 frames: correlation with the truth and, in brackets, confidence,
means over four letters with the same speckle for every nuisance; also for 1 and 2 frames of a scene without an object. A
confident wrong picture (confidence above 0.7, correlation below 0.5) is printed bold; a cell more than 0.05 below clean frames has
an asterisk.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from tqdm import tqdm

import invert
from correlograph.errors import InputError
from data_gen.letters import letter
from invert.albedo.metrics import aligned_pearson

SHAPE = (1028, 1232)
PATCH = 257
LEVEL = 0.4
"""Photoelectrons per pixel: a floor of about 0.15 of (r*r)(0) for a letter."""

LETTERS = "FRL5"

Frames = np.ndarray
Nuisance = Callable[[Frames, np.random.Generator], Frames]


def speckle(albedo: np.ndarray, rng: np.random.Generator, moved: float = 0.0, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Return speckle of mean 1, of a shape, from an albedo (64, 64) whose cells are as wide as a lag of patches of `PATCH` pixels.

    Drawn on a larger periodic grid and cropped, so that it does not wrap round. With `moved`, averaged over a motion of that
    many pixels to the right.
    """
    rows, columns = (int(1.2 * side) for side in shape)
    lag_rows, lag_columns = np.fft.fftfreq(rows) * PATCH, np.fft.fftfreq(columns) * PATCH
    albedo_on_lags = ndimage.map_coordinates(
        albedo.astype(np.float64), np.stack(np.meshgrid(lag_rows + 31.5, lag_columns + 31.5, indexing="ij")), order=0, cval=0.0
    )
    inside = (np.abs(lag_rows)[:, None] < 32.0) & (np.abs(lag_columns) < 32.0)
    field = rng.standard_normal(albedo_on_lags.shape) + 1j * rng.standard_normal(albedo_on_lags.shape)
    wall = np.fft.fft2(field * np.sqrt(albedo_on_lags * inside))[: shape[0], : shape[1] + 64]
    intensity = np.abs(wall) ** 2
    if moved:
        intensity = ndimage.uniform_filter1d(intensity, round(moved), axis=1)
    intensity = intensity[:, : shape[1]]
    return intensity / intensity.mean()


def texture(rng: np.random.Generator, contrast: float, slope: float = 1.0) -> np.ndarray:
    """A wall's albedo of mean 1 with power 1 / f^(2 slope)."""
    frequency = np.hypot(np.fft.fftfreq(SHAPE[0])[:, None] * SHAPE[0], np.fft.rfftfreq(SHAPE[1]) * SHAPE[1])
    frequency[0, 0] = np.inf
    drawn = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(SHAPE)) / frequency**slope, s=SHAPE)
    return np.clip(1.0 + contrast * drawn / drawn.std(), 0.05, None)


ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]] / np.array(SHAPE)[:, None, None] - 0.5


def fringes(period: float, phase: float, angle: float = 0.4) -> np.ndarray:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.sin(2 * np.pi * (row * np.sin(angle) + column * np.cos(angle)) / period + phase)


def each(change: Callable[[np.ndarray, int], np.ndarray]) -> Nuisance:
    """A nuisance that changes frames one by one."""
    return lambda frames, rng: np.stack([change(frame, number) for number, frame in enumerate(frames)])


def of_light(light: Callable[[np.random.Generator, int], list[np.ndarray]]) -> Nuisance:
    """Light that is added to the object's."""
    return lambda frames, rng: frames + np.stack(light(rng, len(frames)))


def of_wall(wall: Callable[[np.random.Generator], np.ndarray]) -> Nuisance:
    """A factor that all frames share."""
    return lambda frames, rng: frames * wall(rng)


def shift_frames(pixels: float) -> Callable:
    """Textured ambient light, the camera shifted by a number of pixels per frame."""

    def light(rng, count):
        wall = texture(rng, 0.2)
        return [ndimage.shift(wall, (0.6 * pixels * n, pixels * n), order=1, mode="nearest") for n in range(count)]

    return of_light(light)


def drifting(by: float) -> Callable:
    def light(rng, count):
        wall = texture(rng, 0.2)
        return [wall * (1.0 + by * number) for number in range(count)]

    return of_light(light)


LIGHT: dict[str, Nuisance] = {
    "clean": lambda frames, rng: frames,
    "vignetting": of_wall(lambda rng: np.cos(np.arctan(1.2 * np.hypot(ROW, COLUMN))) ** 4),
    "Gaussian illumination": of_wall(lambda rng: np.exp(-(ROW**2 + COLUMN**2) / 0.1)),
    "gradient 5:1": of_wall(lambda rng: 1.0 + 4.0 * (COLUMN + 0.5)),
    "wall texture 10 %": of_wall(lambda rng: texture(rng, 0.1)),
    "wall texture 30 %, fine": of_wall(lambda rng: texture(rng, 0.3, 0.6)),
    "ambient, even, 5 x": of_light(lambda rng, count: [5.0 * np.ones(SHAPE)] * count),
    "ambient, textured": of_light(lambda rng, count: [texture(rng, 0.2)] * count),
    "ambient, fringes": of_light(lambda rng, count: [1.0 + 0.2 * fringes(21.0, 0.0)] * count),
    "ambient, moving fringes": of_light(lambda rng, count: [1.0 + 0.2 * fringes(21.0, 2.1 * n) for n in range(count)]),
    "ambient, moving broad fringes": of_light(lambda rng, count: [1.0 + 0.2 * fringes(90.0, 2.1 * n) for n in range(count)]),
    "lamp banding": of_light(lambda rng, count: [1.0 + 0.2 * fringes(60.0, 0.0, np.pi / 2)] * count),
    "moving lamp banding": of_light(lambda rng, count: [1.0 + 0.2 * fringes(60.0, 2.1 * n, np.pi / 2) for n in range(count)]),
    "lamp drift 2 %, textured": drifting(0.02),
    "lamp drift 10 %, textured": drifting(0.1),
    "camera moved 1 pixel, textured": shift_frames(1.0),
    "camera moved 5 pixels, textured": shift_frames(5.0),
    "glint": of_light(lambda rng, count: [400.0 * np.exp(-((ROW - 0.2) ** 2 + COLUMN**2) / 2e-5)] * count),
    "levels 1 to 3": each(lambda frame, number: frame * (1.0 + 2.0 * (number % 2))),
    "blur, deviation 0.5 pixel": each(lambda frame, number: ndimage.gaussian_filter(frame, 0.5)),
    "blur, deviation 1 pixel": each(lambda frame, number: ndimage.gaussian_filter(frame, 1.0)),
    "blur, deviation 2 pixels": each(lambda frame, number: ndimage.gaussian_filter(frame, 2.0)),
    "blur, 1.5 pixels along rows": each(lambda frame, number: ndimage.gaussian_filter(frame, (1.5, 0.0))),
    "dust": of_wall(
        lambda rng: np.prod(
            [1.0 - 0.7 * np.exp(-((ROW - y) ** 2 + (COLUMN - x) ** 2) / 1e-5) for y, x in rng.uniform(-0.5, 0.5, (40, 2))], 0
        )
    ),
}
"""Artefacts of the light before photons are counted."""


def damage_pixels(share: float, value: float, only_first: bool = False) -> Nuisance:
    def change(frames, rng):
        where = rng.random(SHAPE) < share
        changed = frames.copy()
        changed[: 1 if only_first else None, where] = value
        return changed

    return change


def lines(value: float) -> Nuisance:
    def change(frames, rng):
        changed = frames.copy()
        changed[:, 300] = value
        changed[:, :, 500] = value
        return changed

    return change


SENSOR: dict[str, Nuisance] = {
    "hot pixels 0.01 %": damage_pixels(1e-4, 200.0),
    "hot pixels 0.01 % of one frame": damage_pixels(1e-4, 200.0, True),
    "dead pixels 1 %": damage_pixels(1e-2, 0.0),
    "dead row and column": lines(0.0),
    "hot row and column": lines(10.0),
    "saturated": each(lambda frame, number: np.minimum(frame, 1.0)),
    "gain 0.3, offset 100": each(lambda frame, number: 0.3 * frame + 100.0),
    "scale: mean .02": each(lambda frame, number: 0.05 * frame),
    "8 bits": each(lambda frame, number: np.clip(np.round(20.0 * frame + 8.0), 0, 255)),
    "pixel response 3 %": lambda frames, rng: frames * rng.normal(1.0, 0.03, SHAPE),
    "read noise 1 e": lambda frames, rng: frames + rng.normal(0.0, 1.0, frames.shape),
    "read noise of rows": lambda frames, rng: frames + rng.normal(0.0, 0.3, (len(frames), SHAPE[0], 1)),
    "gamma .8": each(lambda frame, number: frame**0.8),
    "dark offset structure": lambda frames, rng: frames + 0.3 * texture(rng, 0.5, 0.0),
}
"""Artefacts of the counted photoelectrons."""

MOTION = {"motion 5 pixels": 5.0}

PAIRS = (
    ("vignetting", "hot pixels 0.01 %"),
    ("ambient, textured", "gain 0.3, offset 100"),
    ("moving lamp banding", "8 bits"),
    ("wall texture 10 %", "read noise of rows"),
    ("lamp drift 10 %, textured", "dead row and column"),
    ("camera moved 1 pixel, textured", "saturated"),
    ("Gaussian illumination", "read noise 1 e"),
)


def frames_of(names: tuple[str, ...], albedo: np.ndarray, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, count])
    moved = next((MOTION[name] for name in names if name in MOTION), 0.0)
    light = np.stack([speckle(albedo, rng, moved) if albedo.any() else np.zeros(SHAPE) for _ in range(count)])
    for name in names:
        light = LIGHT[name](light, rng) if name in LIGHT else light
    counted = rng.poisson(LEVEL * light).astype(np.float64)
    for name in names:
        counted = SENSOR[name](counted, rng) if name in SENSOR else counted
    return counted.astype(np.float32)


def letter_albedo(character: str) -> np.ndarray:
    """A letter of half the window's width, float (64, 64)."""
    return np.pad(letter(character).reshape(32, 8, 32, 8).mean((1, 3)) / 255.0, 16).astype(np.float32)


def cells() -> list[tuple[str, ...]]:
    return [(name,) for name in (*LIGHT, *SENSOR, *MOTION)] + list(PAIRS)


def measure_row(names: tuple[str, ...], albedo: np.ndarray, count: int, seed: int, quality: str) -> dict[str, Any]:
    """Correlation, confidence and warnings of one capture."""
    try:
        result = invert.reconstruct(frames_of(names, albedo, count, seed), quality=quality, patch=PATCH, seed=seed)
    except InputError as error:
        return {"refused": str(error)}
    seen, record = albedo.any() and result.object_found, result.estimate.record
    return {
        "blur_pixels": record and record.blur_found_pixels,
        "found": result.object_found,
        "confidence": round(result.confidence, 3),
        "warnings": list(result.warnings),
        "pearson": round(aligned_pearson(result.albedo, albedo)[0], 3) if seen else 0.0,
    }


def mean_pearson(cell: list[dict[str, Any]]) -> float:
    """Mean correlation of a cell's captures; 0 where no object is claimed or the frames are refused."""
    return float(np.mean([one.get("pearson", 0.0) for one in cell]))


def is_confident_and_wrong(confidence: float, pearson: float) -> bool:
    """Return whether a confidence above 0.7 goes with a correlation below 0.5."""
    return confidence > 0.7 and pearson < 0.5


def written(cell: list[dict[str, Any]], clean: float) -> str:
    """A cell's mean correlation (mean confidence), and how many captures show nothing or are refused.

    Bold where a picture is wrong and confident; with an asterisk where the mean is more than 0.05 below the clean one.
    """
    found, parts = [one for one in cell if one.get("found")], []
    if found:
        below = "*" if mean_pearson(cell) < clean - 0.05 else ""
        confidence = f"({np.mean([one['confidence'] for one in found]):.2f})"
        parts.append(f"{mean_pearson(found):.2f}{below} {confidence}" if clean else confidence)
    for word, number in (
        ("refused", sum("refused" in one for one in cell)),
        ("none", sum(not one.get("found", True) for one in cell)),
    ):
        parts += [word if number == len(cell) else f"{number} {word}"] if number else []
    wrong = any(is_confident_and_wrong(one["confidence"], one["pearson"]) for one in found)
    return f"**{', '.join(parts)}**" if wrong else ", ".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/nuisances"))
    parser.add_argument("--quality", default="fast")
    parser.add_argument("--only", default="", help="measure artefacts whose name contains this text, and clean frames")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    truths, rows = [letter_albedo(one) for one in LETTERS], {}
    columns = [
        ("1 frame", 1, False),
        ("2 frames", 2, False),
        ("10 frames", 10, False),
        ("1, no object", 1, True),
        ("2, no object", 2, True),
    ]
    wanted = [names for names in cells() if names == ("clean",) or options.only in " + ".join(names)]
    for names in tqdm(wanted, unit="nuisance", disable=None):
        rows[" + ".join(names)] = {
            label: [measure_row(names, truth * (not empty), count, seed, options.quality) for seed, truth in enumerate(truths)]
            for label, count, empty in columns
        }
    (options.output / "rows.json").write_text(json.dumps(rows, indent=1))
    clean = {label: 0.0 if empty else mean_pearson(rows["clean"][label]) for label, _, empty in columns}
    lines = ["| | " + " | ".join(label for label, _, _ in columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [
        f"| {name} | " + " | ".join(written(row[label], clean[label]) for label in clean) + " |" for name, row in rows.items()
    ]
    (options.output / "table.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
