"""List of the light paths of a scene, with share, coherence and effect of each."""

from __future__ import annotations

import math
from dataclasses import dataclass

from radiometry.light_budget_rows import detector_to_pixel, light_budget
from sim.geometry import Geometry
from sim.optics.other_light import visibility_by_shape
from sim.plan import Plan

MIN_VISIBILITY = 1e-4
"""Mean gamma^2 below which light adds in intensity, as in the simulator (gamma 1e-2)."""


@dataclass(frozen=True)
class LightPath:
    """Light that reaches the frame in one way.

    Attributes:
        share: its photons in units of those of the hidden object; None without light from the object.
        visibility: factor gamma^2 by which its beats with the object are lowered; 0 for light of another source.
        effect: its effect on a frame, in a few words.
    """

    name: str
    share: float | None
    visibility: float
    effect: str


def light_paths(plan: Plan) -> list[LightPath]:
    """Return the object, shapes that send stray laser light, direct light and lamps."""
    geometry = plan.geometry
    per_frame = light_budget(geometry.light_path).per_pixel * geometry.light_path.pixels
    found = [LightPath("hidden_object", 1.0 if per_frame else None, 1.0, "signal")]
    seen, modelled = visibility_by_shape(geometry, plan.samples), plan.effects["other_light"].modelled
    for shape, fraction in geometry.other_light.fractions.items() if geometry.other_light else ():
        name = f"{shape}, several reflections" if shape.startswith("hidden_object") else shape
        kept = seen.get(shape, 0.0)
        way = "beats with the object at lags of their distance" if kept >= MIN_VISIBILITY else "adds in intensity"
        share = fraction * geometry.other_light_share if per_frame else None
        found.append(LightPath(name, share, kept, way if modelled else f"{way}; too little to be modelled"))
    direct = direct_light_per_frame(geometry)
    blocked = "blocked" if direct == 0.0 else "not modelled; add a baffle"
    found.append(LightPath("direct_light", direct / per_frame if per_frame else None, 0.0, blocked))
    rate = geometry.ambient_photoelectrons_per_pixel_s
    lamps = 0.0 if rate is None else float(rate.mean())
    signal = light_budget(geometry.light_path).photoelectrons_per_pixel_s
    found.append(LightPath("lamps", lamps / signal if signal else None, 0.0, "adds in intensity" if lamps else "none"))
    return found


def direct_light_per_frame(geometry: Geometry) -> float:
    """Return the photoelectrons of a frame per laser photon that come straight from the virtual source."""
    area = math.prod(geometry.camera.frame_shape) * geometry.camera.pixel_pitch_m**2
    return geometry.direct_light * area * detector_to_pixel(geometry.light_path)


def describe(paths: list[LightPath]) -> str:
    """Return the paths with a thousandth of the object's light or more, in one line."""
    shown = [path for path in paths[1:] if path.share is not None and path.share >= 1e-3]
    return (
        ", ".join(f"{path.name} {path.share:.2g} of the object's light ({path.effect})" for path in shown) or "the object alone"
    )
