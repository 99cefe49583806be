"""The reference scene on a small frame, edited."""

from __future__ import annotations

import pytest


@pytest.fixture
def depolarising() -> tuple[str, str]:
    """Return the edit of `scene` by which both walls and the object depolarise."""
    opening = '<bsdf type="phase_screen">'
    return opening, f'{opening}<boolean name="depolarising" value="true"/>'


@pytest.fixture
def scene(tmp_path):
    """scene(("old", "new"), ...) -> Geometry of the reference scene on a small frame, edited."""
    pytest.importorskip("mitsuba")
    from scenes import scene_path
    from sim.scene_file import load_scene
    from sim.scene_reader import read_geometry

    def make(*changes: tuple[str, str]):
        text = scene_path("corner_letter").read_text()
        text = text.replace('value="2464"', 'value="616"').replace('value="2056"', 'value="514"')
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "scene.xml").write_text(text)
        (tmp_path / "F.png").write_bytes(scene_path("corner_letter").with_name("F.png").read_bytes())
        return read_geometry(load_scene(tmp_path / "scene.xml")[0])

    return make
