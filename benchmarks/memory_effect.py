"""`python -m benchmarks.memory_effect [-o docs/figures]`: correlography beside speckle correlation through the memory effect.

Compares light, contrast, resolution, field of view and reconstructions for one scene, camera and exposure time. Both methods
get the same retrieval. Writes memory_effect.png and prints the table.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

import invert
import sim
from invert.albedo.metrics import aligned_pearson
from invert.albedo.registration import consensus, crop_centred
from invert.solvers.base import PhaseProblem, solve
from invert.solvers.hio import Hio
from radiometry.prediction import predict
from sim.memory_effect import MemoryEffect, autocovariance
from sim.rendering import render_geometry

EXPOSURES_S = (1 / 8, 10.0, 1000.0)
FRAMES = 20
PAINT_M = 100e-6
"""Thickness of a diffusing coat of paint, for comparison."""


def by_memory_effect(memory: MemoryEffect, seconds: float) -> np.ndarray:
    """Reconstruction (64, 64) from `FRAMES` frames: HIO on the power spectrum of the autocovariance."""
    rng = np.random.default_rng(0)
    lags = autocovariance([memory.frame(seconds, rng) for _ in range(FRAMES)])
    lags[63, 63] = 0.5 * (lags[63, 64] + lags[64, 63])  # holds the shot noise
    window = np.hypot(*np.mgrid[-63:64, -63:64]) < 48
    padded = np.zeros((128, 128), np.float32)
    padded[:127, :127] = (lags - lags[window].min()) * window
    power = np.fft.rfft2(np.roll(padded, (-63, -63), (0, 1))).real
    modulus = torch.from_numpy(np.sqrt(np.maximum(power, 0.0)).astype(np.float32))
    found = solve(Hio(), PhaseProblem(modulus / modulus.max(), 48), torch.Generator().manual_seed(0))
    return crop_centred(consensus(found.images, found.residual).image.clamp_min(0.0)).numpy()


def by_correlography(scene: sim.Scene, seconds: float) -> np.ndarray:
    """Reconstruct the object from as many coherent frames."""
    capture = render_geometry(scene.geometry.with_exposure(seconds), FRAMES)
    return invert.reconstruct(capture, method="classical").albedo


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"))
    output = parser.parse_args().output
    scene = sim.load("corner_letter")
    geometry, memory = scene.geometry, MemoryEffect.of(scene.geometry)
    prediction = predict(geometry)
    truth = memory.cells / memory.cells.max()
    per_frame = prediction.terms.light.signal * np.prod(geometry.camera.frame_shape) / geometry.camera.electronics.exposure_s
    reach = 0.5 * geometry.wavelength_m * geometry.distance_m / geometry.camera.pixel_pitch_m
    noise = prediction.signal_to_noise(FRAMES)
    rows = [
        (
            "third-bounce photoelectrons per second and frame",
            f"{per_frame:.3g}",
            f"{memory.photoelectrons_per_pixel_s * np.prod(memory.frame_shape):.3g}",
        ),
        ("aperture", f"{geometry.camera.pupil_diameter_m * 1e3:.3g} mm", f"{memory.aperture_m * 1e3:.3g} mm"),
        ("contrast", "1", f"{memory.contrast:.2g}"),
        ("resolution", f"{prediction.pitch_m * 1e6:.3g} um", f"{memory.pitch_m * 1e6:.3g} um"),
        (
            "field of view",
            f"{reach * 1e3:.3g} mm (pixel pitch)",
            f"{memory.field_of_view_m * 1e3:.3g} mm (rough surface), "
            f"{memory.within(PAINT_M, geometry.wavelength_m) * 1e3:.2g} mm "
            f"(paint of {PAINT_M * 1e6:.0f} um)",
        ),
        (
            f"signal to noise, {FRAMES} frames of 1/8 s",
            f"{noise:.2g}",
            f"{memory.signal_to_noise(1 / 8) * FRAMES**0.5:.2g} (shot noise alone)",
        ),
    ]
    images: list[list[np.ndarray]] = [[], []]
    for seconds in EXPOSURES_S:
        for index, image in enumerate((by_correlography(scene, seconds), by_memory_effect(memory, seconds))):
            pearson, moved = aligned_pearson(image, truth)
            images[index].append(moved)
            print(f"{('correlography', 'memory effect')[index]}, {FRAMES} frames of {seconds:g} s: correlation {pearson:.2f}")
    print("| | correlography | memory effect |\n|---|---|---|")
    print("\n".join(f"| {name} | {ours} | {theirs} |" for name, ours, theirs in rows))
    _draw(output / "memory_effect.png", truth, images)


def _draw(path: Path, truth: np.ndarray, images: list[list[np.ndarray]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.2 * (len(EXPOSURES_S) + 1), 4.8), layout="constrained")
    grid = figure.subplots(2, len(EXPOSURES_S) + 1)
    for row, name in enumerate(("correlography", "memory effect")):
        for column, image in enumerate([*images[row], truth]):
            axes = grid[row, column]
            axes.imshow(image, cmap="gray", interpolation="nearest", vmin=0.0)
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_title("truth" if column == len(EXPOSURES_S) else f"{FRAMES} x {EXPOSURES_S[column]:g} s", fontsize=9)
        grid[row, 0].set_ylabel(name, fontsize=9)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
