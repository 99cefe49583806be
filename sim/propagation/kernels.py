"""The propagation kernels by name: one signature, and each with a prediction of its own error and cost.

To add one: write `propagate(scatterers, wall, terms) -> complex tensor (H, W)` and `predict(task) -> list[Option]` in a file of
its own, and enter both here. `choose.py` then chooses it where it is the cheapest that holds the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from sim.propagation import direct, fraunhofer, fresnel, nufft
from sim.propagation.option import Option, Task, Terms
from sim.propagation.sampling import Scatterers, Wall


@dataclass(frozen=True)
class Kernel:
    """One way from scatterers to the wall.

    Attributes:
        propagate: field on the wall (H, W), complex.
        predict: its options for a task, one a precision.
        on_lattice: whether it needs the scatterers' lattice, and gives each the same amplitude everywhere in the frame.
        sees_occluders: whether it asks what stands between scatterer and pixel.
        planning_seconds: time that its prediction takes, which a cheap kernel within the tolerance saves.
    """

    propagate: Callable[[Scatterers, Wall, Terms], torch.Tensor]
    predict: Callable[[Task], list[Option]]
    on_lattice: bool = False
    sees_occluders: bool = False
    planning_seconds: float = 0.0


KERNELS = {
    "fraunhofer": Kernel(fraunhofer.propagate, fraunhofer.predict, on_lattice=True),
    "fresnel": Kernel(fresnel.propagate, fresnel.predict, on_lattice=True),
    "direct": Kernel(direct.propagate, direct.predict, sees_occluders=True),
    "nufft": Kernel(nufft.propagate, nufft.predict, planning_seconds=0.5),
}
"""Cheapest predictions first."""
