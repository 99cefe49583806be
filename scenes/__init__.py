"""Scenes, one folder each: scene.xml, meshes, albedo bitmaps. `scene_path("corner_letter")` finds them."""

from importlib.resources import files
from pathlib import Path


def scene_path(name: str) -> Path:
    """Path of a shipped scene file."""
    return Path(str(files("scenes"))) / name / "scene.xml"
