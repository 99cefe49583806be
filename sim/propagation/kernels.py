"""List of the propagators: a common signature, each with a prediction of its error and cost.

To add one, write `propagate(scatterers, wall, terms) -> complex tensor (H, W)` and `predict(task) -> list[Option]` in a new file
and list both here. `choose.py` then selects it whenever it is the fastest within the tolerance.
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
    """One propagator.

    Attributes:
        propagate: returns the field on the wall (H, W), complex.
        predict: returns its options for a task, one per precision.
        on_lattice: whether it needs scatterers on a regular grid; it then gives each scatterer the same amplitude at all
            pixels.
        from_corner: whether the phases on the wall refer to the corner of that grid, not to the object's centre.
        sees_occluders: whether it models occluders between scatterer and pixel.
        planning_seconds: time to predict its error, which is skipped if a faster propagator is within the tolerance.
    """

    propagate: Callable[[Scatterers, Wall, Terms], torch.Tensor]
    predict: Callable[[Task], list[Option]]
    on_lattice: bool = False
    from_corner: bool = False
    sees_occluders: bool = False
    planning_seconds: float = 0.0


KERNELS = {
    "fraunhofer": Kernel(fraunhofer.propagate, fraunhofer.predict, on_lattice=True, from_corner=True),
    "fresnel": Kernel(fresnel.propagate, fresnel.predict, on_lattice=True),
    "direct": Kernel(direct.propagate, direct.predict, sees_occluders=True),
    "nufft": Kernel(nufft.propagate, nufft.predict, planning_seconds=0.5),
}
"""Kernels, fastest prediction first."""
