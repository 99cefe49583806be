"""
Your own scene: mesh, lamp, occluder
====================================

A scene as a dictionary, as for ``mi.load_dict``: a hidden mesh, a lamp that illuminates the wall, and a pillar next to the object.
The pillar shows why stray laser light matters.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import trimesh

import correlograph as cg
import sim  # noqa: F401 - selects the Mitsuba variant and registers the plugins

# %%
# The hidden object is an L of two bars, 3 mm deep, as a mesh. ``correlograph mesh`` converts any mesh that trimesh reads.

bars = [trimesh.creation.box((0.002, 0.010, 0.003)), trimesh.creation.box((0.006, 0.002, 0.003))]
bars[1].apply_translation((0.004, -0.004, 0.0))
folder = Path(tempfile.mkdtemp())
trimesh.util.concatenate(bars).export(folder / "object.ply")


def wall(albedo: float) -> dict:
    """Return a rough, diffuse surface."""
    return {
        "type": "phase_screen",
        "height_rms": 2e-6,
        "correlation_length": 10e-6,
        "surface": {"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}},
    }


def look(origin: list[float], target: list[float]) -> mi.ScalarTransform4f:
    """Return the pose of a laser or a camera."""
    return mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[0, 1, 0])


place, wall_z = [0.104, 0.0, 0.489], 1.0


def content(pillar_albedo: float) -> dict:
    """Return the scene with a pillar of the given albedo."""
    return {
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
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": pillar_albedo}},
            "to_world": mi.ScalarTransform4f().translate([-0.03, 0, 0.2]) @ mi.ScalarTransform4f().scale([0.005, 0.03, 1]),
        },
        "lamp": {"type": "point", "position": [0.3, 0.5, 0.2], "intensity": {"type": "uniform", "value": 1e-12}},
    }


# %%
# A grey pillar sends much more light to the virtual detector than the object. The plan and the drawing report it as stray light.

grey = cg.load(content(pillar_albedo=0.5))
print(f"stray light: {grey.geometry.other_light_share:.0f} times the light of the object")
grey

# %%
# The autocorrelation then shows the pillar as well as the object, and the reconstruction is a blurred mixture of both. A pillar
# painted black (albedo 0) solves the problem.

black = cg.load(content(pillar_albedo=0.0))
figure, axes = plt.subplots(1, 3, figsize=(10, 3.4), layout="constrained")
for panel, scene, name in zip(axes, (grey, black), ("grey pillar", "black pillar"), strict=False):
    capture = cg.render(scene, frames=2, seed=3)
    result = cg.reconstruct(capture, quality="fast")
    comparison = result.compare(cg.Truth.of(capture))
    panel.imshow(comparison.albedo, cmap="gray")
    panel.set(title=f"{name}: correlation {comparison.pearson:.2f}", xticks=[], yticks=[])
axes[2].imshow(comparison.truth, cmap="gray")
axes[2].set(title="true albedo", xticks=[], yticks=[])
