"""The chain of stages, in the order in which electrons pass them."""

from __future__ import annotations

import numpy as np

from radiometry.sensor.converter import FullWell, Quantisation
from radiometry.sensor.electronics import Electronics
from radiometry.sensor.photons import DarkCurrent, PhotonCounting, ShotNoise
from radiometry.sensor.readout_noise import ColumnNoise, FixedPattern, ReadNoise, RowNoise
from radiometry.sensor.stage import Stage

CHAIN: tuple[Stage, ...] = (
    DarkCurrent(),
    ShotNoise(),
    PhotonCounting(),
    ReadNoise(),
    RowNoise(),
    ColumnNoise(),
    FixedPattern(),
    FullWell(),
    Quantisation(),
)


def stages_of(electronics: Electronics) -> list[Stage]:
    """Return the stages that a camera has."""
    return [stage for stage in CHAIN if stage.is_set(electronics)]


def expose(photoelectrons: np.ndarray, electronics: Electronics, rng: np.random.Generator) -> np.ndarray:
    """Sample one recorded frame (H, W) from expected photoelectrons, float32, in electrons."""
    electrons = photoelectrons.copy()
    for stage in stages_of(electronics):
        electrons = stage.record(electrons, electronics, rng)
    return electrons.astype(np.float32, copy=False)
