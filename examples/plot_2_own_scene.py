"""
A scene of one's own: mesh, lamp, occluder
==========================================

A scene as a dictionary, as for ``mi.load_dict``: a bent strip made with trimesh is hidden, a lamp shines on the wall, and a
pillar stands beside the object.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
import trimesh

import invert
import radiometry
import sim

# %%
# The hidden object: an L of two bars, 3 mm deep, as a mesh. Any mesh that trimesh reads will do (``python -m sim.mesh``).

bars = [trimesh.creation.box((0.002, 0.010, 0.003)), trimesh.creation.box((0.006, 0.002, 0.003))]
bars[1].apply_translation((0.004, -0.004, 0.0))
folder = Path(tempfile.mkdtemp())
trimesh.util.concatenate(bars).export(folder / "object.ply")


def wall(albedo: float) -> dict:
    return {
        "type": "phase_screen",
        "height_rms": 2e-6,
        "correlation_length": 10e-6,
        "surface": {"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}},
    }


def look(origin: list[float], target: list[float]) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0])


place, wall_z = [0.104, 0.0, 0.489], 1.0
content = {
    "type": "scene",
    "laser": {
        "type": "laser",
        "wavelength": 532e-9,
        "power": 0.3,
        "spot_diameter": 5e-3,
        "to_world": look([0.06, 0.25, 0.1], place),
    },
    "virtual_source": {
        "type": "rectangle",
        "bsdf": wall(1.0),
        "to_world": mi.ScalarTransform4f().look_at(origin=place, target=[0, 0, 0], up=[0, 1, 0])
        @ mi.ScalarTransform4f().scale([0.02, 0.02, 1]),
    },
    "hidden_object": {"type": "ply", "filename": str(folder / "object.ply"), "face_normals": True, "bsdf": wall(0.8)},
    "virtual_detector": {
        "type": "rectangle",
        "bsdf": wall(0.9),
        "to_world": mi.ScalarTransform4f().translate([0, 0, wall_z])
        @ mi.ScalarTransform4f().rotate([0, 1, 0], 180)
        @ mi.ScalarTransform4f().scale([0.015, 0.015, 1]),
        "camera": {
            "type": "speckle_camera",
            "pixel_pitch": 3.45e-6,
            "magnification": 0.5,
            "pupil_diameter": 0.0514,
            "exposure": 0.25,
            "to_world": look([-0.112, 0, wall_z - 0.528], [0, 0, wall_z]),
            "film": {"type": "hdrfilm", "width": 1232, "height": 1028, "pixel_format": "luminance"},
        },
    },
    "baffle": {
        "type": "rectangle",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
        "to_world": mi.ScalarTransform4f().translate([0.095, 0, 0.6]) @ mi.ScalarTransform4f().scale([0.05, 0.05, 1]),
    },
    "pillar": {
        "type": "rectangle",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}},
        "to_world": mi.ScalarTransform4f().translate([-0.03, 0, 0.2]) @ mi.ScalarTransform4f().scale([0.005, 0.03, 1]),
    },
    "lamp": {"type": "point", "position": [0.3, 0.5, 0.2], "intensity": {"type": "uniform", "value": 1e-12}},
}
scene = sim.load(content)

# %%
# The plan says what matters in this scene. The lamp is in it, the pillar's own light is listed.

plan = scene.plan()
for effect in plan.effects.values():
    print(f"{'modelled' if effect.modelled else 'left out':9} {effect.name}: {effect.why}")
print(f"{radiometry.light_budget(scene).per_pixel_db:.1f} dB per pixel")

# %%
capture = sim.render(scene, frames=2, seed=3)
result = invert.reconstruct(capture, quality="fast")
figure, axes = plt.subplots(1, 2, figsize=(6, 3), layout="constrained")
for panel, title, image in zip(axes, ("reconstruction", "truth"), (result.albedo, capture.truth), strict=True):
    panel.imshow(np.asarray(image), cmap="gray")
    panel.set(title=title, xticks=[], yticks=[])
