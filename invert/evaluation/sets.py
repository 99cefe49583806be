"""Test sets of an evaluation: estimates with their truths, at levels of noise or exposure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from correlograph.errors import InputError
from correlograph.lags import LAGS, OBJECT_SIDE
from invert.choices import BEST, CLASSICAL
from invert.evaluation.unusual import KINDS, draw_unusual
from invert.measure.estimate import Estimate, estimate_from_frames, published_estimate
from invert.measure.spectrum import Measurement, read_measurement
from invert.pipeline import reconstruct
from invert.request import Request
from invert.training.data import at_noise
from radiometry.estimation.background import MeanModel

NOISE_LEVELS = ((80.0, 64.0), (80.0, 16.0), (80.0, 256.0), (80.0, 1e4), (5.0, 64.0), (5.0, 1e4), (200.0, 64.0), (200.0, 256.0))
"""Noise floor (of 255 at the maximum lag except zero) and K; near the training point of Metzler et al. 2020 (b 70, K 67)
first."""

UNUSUAL_LEVELS = ((10.0, 300.0), (80.0, 300.0), (200.0, 300.0), (400.0, 300.0))
"""Noise floor and K of the set of unusual objects; K of two frames of the reference scene."""

EXPOSURES_S = tuple(2.0**-power for power in range(2, 10))
EDGE_EXPOSURES_S = (1 / 8, 1 / 32, 1 / 128)
"""Exposures of rendered letters and of rendered edges."""

JUDGES_S = 0.5
"""Minimum exposure of the captures that score reconstructions of other captures."""

LETTERS = ("F", "7", "L", "R", "5", "t")
UNSEEN_CHARACTERS = "EGHJKMNPSYZ2345679"
"""Characters of the out-of-family set; no training target shows one, mirrored or rotated."""


@dataclass(frozen=True)
class Case:
    """One estimate of an object, the truth (64, 64) or its substitute, and other captures of the same object."""

    name: str
    estimate: Estimate
    truth: np.ndarray
    others: tuple[Measurement, ...] = ()


@dataclass(frozen=True)
class Level:
    """All cases of one test set at one noise level or exposure."""

    test_set: str
    label: str
    cases: list[Case]


def edges(images: Path, count: int, seed: int) -> Iterator[Level]:
    """Canny edges of photographs, one crop each, with noise from the noise model."""
    yield from _noise_model_levels("edges", _edge_targets(images, count, seed), seed)


def _edge_targets(images: Path, count: int, seed: int) -> np.ndarray:
    from data_gen.edges import edge_targets, find_photographs, read_luminance

    rng = np.random.default_rng(seed)
    photographs = find_photographs(images)
    truths: list[np.ndarray] = []
    for index in rng.permutation(len(photographs.names)):
        if len(truths) == count:
            break
        found = edge_targets(read_luminance(photographs.folder / photographs.names[index]), 1, rng)
        if found is not None:
            truths.append(found[0].astype(np.float32) / np.float32(255.0))
    if not truths:
        raise InputError("--images", "photographs with edges", f"none in {images}", "use another folder")
    return np.stack(truths)


def shapes(count: int, seed: int) -> Iterator[Level]:
    """Letters and digits in random poses and weights, which no training target shows, with noise from the noise model."""
    from data_gen.shapes import glyph

    rng = np.random.default_rng(seed)
    truths = np.stack([glyph(UNSEEN_CHARACTERS[number % len(UNSEEN_CHARACTERS)], rng) for number in range(count)])
    yield from _noise_model_levels("shapes", truths.astype(np.float32) / np.float32(255.0), seed)


def unusual(count: int, seed: int) -> Iterator[Level]:
    """Objects of sixteen kinds in turn that no training target shows, with noise from the noise model."""
    truths = [draw_unusual(KINDS[number % len(KINDS)], np.random.default_rng([seed, number])) for number in range(count)]
    yield from _noise_model_levels("unusual", np.stack(truths), seed, UNUSUAL_LEVELS)


def grey(images: Path, count: int, seed: int) -> Iterator[Level]:
    """Pieces of photographs in filled shapes, with noise from the noise model."""
    from data_gen.edges import find_photographs, read_luminance
    from data_gen.pieces import piece

    rng = np.random.default_rng(seed)
    photographs = find_photographs(images)
    names = rng.permutation(photographs.names)[:count]
    truths = np.stack([piece(read_luminance(photographs.folder / name), rng) for name in names])
    yield from _noise_model_levels("grey", truths, seed)


def _noise_model_levels(
    name: str, truths: np.ndarray, seed: int, levels: Sequence[tuple[float, float]] = NOISE_LEVELS
) -> Iterator[Level]:
    for floor, dof in levels:
        rng = torch.Generator().manual_seed(seed)
        batch = at_noise(torch.from_numpy(truths), floor / 255.0, dof, rng)
        cases = [
            Case(str(number), Estimate(str(number), estimate.numpy()), truth)
            for number, (estimate, truth) in enumerate(zip(batch.seen.values, truths, strict=True))
        ]
        yield Level(name, f"b {floor:.0f}, K {dof:g}", cases)


def render_letter_set(count: int, seed: int, frames: int, mean_models: Sequence[MeanModel]) -> Iterator[Level]:
    """Render frames of `scenes/corner_letter` with each of its letters over exposures, `count` captures of each letter.

    The estimates of all background models come from the same frames.
    """
    import sim

    scenes = {letter: sim.load("corner_letter", albedo=f"{letter}.png").geometry for letter in LETTERS}
    seeds = range(seed, seed + count)
    objects = [(letter, geometry, _cell_means(geometry), seeds) for letter, geometry in scenes.items()]
    for exposure_s in EXPOSURES_S:
        yield from _rendered_levels("rendered", exposure_s, frames, mean_models, objects)


def _cell_means(geometry: Any) -> np.ndarray:
    from radiometry.prediction import patches_of

    return geometry.hidden_object.cell_means(patches_of(geometry)[1], OBJECT_SIDE)


def rendered_edges(images: Path, count: int, seed: int, frames: int, mean_models: Sequence[MeanModel]) -> Iterator[Level]:
    """Render frames of the reference scene with Canny edges of photographs, one lag wide, in place of its letter."""
    import sim
    from radiometry.prediction import patches_of

    truths = _edge_targets(images, count, seed)
    geometry = sim.load("corner_letter").geometry
    pitches_m = patches_of(geometry)[1]
    objects = [
        (str(number), geometry.with_object(truth, pitches_m), truth, range(seed + number, seed + number + 1))
        for number, truth in enumerate(truths)
    ]
    for exposure_s in EDGE_EXPOSURES_S:
        yield from _rendered_levels("rendered edges", exposure_s, frames, mean_models, objects)


def set_names(name: str, frames: int, mean_models: Sequence[MeanModel]) -> list[str]:
    """Return the names of the test sets that `--sets NAME` evaluates."""
    if name == "measured":
        return ["measured 7", "measured letters"]
    if not name.startswith("rendered"):
        return [name]
    return [_rendered_name(name.replace("-", " "), frames, mean_model) for mean_model in mean_models]


def _rendered_name(name: str, frames: int, mean_model: MeanModel) -> str:
    label = name if mean_model == "auto" else f"{name}, mean {mean_model}"
    return label if frames == 2 else f"{label}, frames {frames}"


def _rendered_levels(
    name: str,
    exposure_s: float,
    frames: int,
    mean_models: Sequence[MeanModel],
    objects: Sequence[tuple[str, Any, np.ndarray, range]],
) -> Iterator[Level]:
    """Yield one level per background model, of objects (name, geometry, truth, seeds of the captures)."""
    from sim.rendering import render_geometry

    cases: dict[MeanModel, list[Case]] = {mean_model: [] for mean_model in mean_models}
    for case, geometry, truth, seeds in objects:
        for seed in seeds:
            capture = render_geometry(geometry.with_exposure(exposure_s), frames, seed)
            for mean_model in mean_models:
                estimate = estimate_from_frames(capture, Request(mean_model=mean_model, lags=LAGS))  # as many as the truth has
                cases[mean_model].append(Case(case, replace(estimate, frame=None), truth))
    for mean_model in mean_models:
        yield Level(_rendered_name(name, frames, mean_model), f"1/{1.0 / exposure_s:.0f} s", cases[mean_model])


def load_measured_set(folder: Path) -> Iterator[Level]:
    """Captures of Metzler et al. 2020: a hidden digit 7 at several exposures, and hidden letters, estimated from 1 to 25 patches.

    There is no truth. Its substitute is the classical reconstruction, from many starts, of the longest exposure of the 7, and of
    fifty frames of a letter.
    Each reconstruction of the 7 is also scored by the likelihood of the other long exposures given this reconstruction.
    """
    files = sorted(folder.glob("*.png"))
    series = sorted((file for file in files if "usec" in file.name), key=_microseconds, reverse=True)
    letters = {file.name.split("_")[0]: file for file in sorted(folder.glob("*_n50_*.png"))}
    if not series or not letters:
        raise InputError("--measured", "a folder of published autocorrelations", f"none in {folder}", "check the path")
    longest = _reference(series[0])
    judges = {file: _read_measurement(file) for file in series if _microseconds(file) >= JUDGES_S * 1e6}
    for file in series:
        others = tuple(judge for name, judge in judges.items() if name != file)
        yield Level("measured 7", f"{_microseconds(file) / 1e3:.4g} ms", [Case("7", published_estimate(file), longest, others)])
    references = {letter: _reference(file) for letter, file in letters.items()}
    yield Level(
        "measured letters",
        "50 frames",
        [Case(letter, published_estimate(file), references[letter]) for letter, file in letters.items()],
    )
    for patches in (25, 10, 5, 3, 2, 1):
        found = {letter: next(folder.glob(f"{letter}_n2_*npatch{patches}.png"), None) for letter in letters}
        cases = [Case(letter, published_estimate(file), references[letter]) for letter, file in found.items() if file]
        if cases:
            yield Level("measured letters", f"2 frames, K {patches}", cases)


def _read_measurement(file: Path) -> Measurement:
    estimate = published_estimate(file)
    return read_measurement(estimate.values, estimate.quantisation)


def _reference(file: Path) -> np.ndarray:
    return reconstruct(published_estimate(file), method=CLASSICAL, quality=BEST).albedo


def _microseconds(file: Path) -> float:
    return float(file.name.split("usec")[0].split("_")[-1])
