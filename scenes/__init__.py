"""Scenes, one folder each: scene.xml, meshes, albedo bitmaps. `scene_path("corner_letter")` finds them; `corner.py` writes others."""

from importlib.resources import files
from pathlib import Path


def scene_path(name: str) -> Path:
    """Return the path of a shipped scene file."""
    return Path(str(files("scenes"))) / name / "scene.xml"


def scene_names() -> list[str]:
    """Return the names of the shipped scenes."""
    return sorted(path.parent.name for path in Path(str(files("scenes"))).glob("*/scene.xml"))
