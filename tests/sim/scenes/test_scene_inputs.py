"""Scene files that would mislead or crash Mitsuba: each is refused in one line, and each asset changes the digest."""

from __future__ import annotations

import re
import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import correlograph as cg
import sim
from scenes import scene_path

TEXTURE = '<texture type="bitmap" name="reflectance">'


@pytest.fixture
def scene(tmp_path) -> Path:
    """A copy of the reference scene that a test may edit."""
    shutil.copytree(scene_path("corner_letter").parent, tmp_path / "scene")
    return tmp_path / "scene" / "scene.xml"


def edit(scene: Path, old: str, new: str) -> Path:
    content = scene.read_text()
    assert old in content
    scene.write_text(content.replace(old, new, 1))
    return scene


def refusal(scene: Path) -> str:
    with pytest.raises(cg.InputError) as error:
        _ = sim.load(scene).geometry
    return str(error.value)


def write_exr(path: Path, pixels: np.ndarray) -> None:
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": pixels.astype(np.float32)}).write(str(path))


@pytest.mark.parametrize(("value", "expected"), [(np.nan, "finite"), (np.inf, "finite"), (-0.5, "zero or more")])
def test_a_texture_of_impossible_numbers_is_refused(scene, value, expected):
    pixels = np.full((16, 16), 0.5)
    pixels[3, 4] = value
    write_exr(scene.parent / "odd.exr", pixels)
    with pytest.raises(cg.InputError, match=expected):
        _ = sim.load(scene, albedo="odd.exr").geometry


@pytest.mark.parametrize("value", ["nan", "-0.2"])
def test_a_wall_of_impossible_albedo_is_refused(scene, value):
    element = re.search(r'<spectrum name="reflectance"[^>]*>', scene.read_text())
    edit(scene, element.group(), f'<spectrum name="reflectance" value="{value}"/>')
    assert "reflectance" in refusal(scene)


def test_a_shape_of_impossible_size_is_refused(scene):
    edit(scene, "</scene>", '<shape type="sphere"><float name="radius" value="nan"/><bsdf type="diffuse"/></shape></scene>')
    assert "expected" in refusal(scene)


def test_a_texture_without_a_file_is_refused(scene):
    edit(scene, "</scene>", f'<shape type="sphere"><bsdf type="diffuse">{TEXTURE}</texture></bsdf></shape></scene>')
    assert "filename" in refusal(scene)
    with pytest.raises(cg.InputError, match="bitmap"):
        cg.load({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap"}}}})


def test_includes_that_multiply_are_refused(tmp_path):
    for depth in range(8):
        includes = f'<include filename="level{depth + 1}.xml"/>' * 10 if depth < 7 else ""
        (tmp_path / f"level{depth}.xml").write_text(f'<scene version="3.0.0">{includes}</scene>')
    assert "1000 files" in refusal(tmp_path / "level0.xml")


@pytest.mark.parametrize(
    ("attributes", "found"),
    [
        ('value="400:0, 500:0, 501:1, 700:1"', "400:0, 500:0"),
        ('filename="wall.spd"', "wall.spd"),
        ('type="blackbody"', "type blackbody"),
        ('value="$bands"', "400:0.1"),
    ],
)
def test_a_spectrum_is_not_taken_for_its_luminance(scene, attributes, found):
    (scene.parent / "wall.spd").write_text("400 0.5\n700 0.5\n")
    edit(scene, "</scene>", '<default name="bands" value="400:0.1, 700:0.9"/></scene>')
    element = re.search(r'<spectrum name="reflectance"[^>]*>', scene.read_text())
    edit(scene, element.group(), f'<spectrum name="reflectance" {attributes}/>')
    told = refusal(scene)
    assert "a value at the laser's wavelength" in told
    assert found in told


@pytest.mark.parametrize(
    ("index", "axes"), [(4, "xyz"), (-1, "xyz"), (2_000_000_000, "xyz"), (4, "xyzst"), (2_000_000_000, "xyzst")]
)
def test_a_face_of_a_vertex_that_a_mesh_lacks_is_refused(scene, index, axes):
    lines = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in axes)]
    lines += ["element face 2", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{place}{' 0 0' if 's' in axes else ''}" for place in ("50 0 0", "51 0 0", "51 1 0", "50 1 0")]
    (scene.parent / "clutter.ply").write_text("\n".join([*lines, "3 0 1 2", f"3 0 2 {index}"]) + "\n")
    edit(scene, "</scene>", '<shape type="ply"><string name="filename" value="clutter.ply"/></shape></scene>')
    told = refusal(scene)
    assert "clutter.ply: expected faces of its own vertices" in told
    assert str(index) in told


def test_a_serialized_mesh_with_a_face_of_a_vertex_that_it_lacks_is_refused(scene):
    single_precision = 0x1000
    corners = np.float32([[50, 0, 0], [51, 0, 0], [51, 1, 0], [50, 1, 0]])
    body = struct.pack("<I", single_precision) + b"\0" + struct.pack("<QQ", 4, 2)
    body += corners.tobytes() + np.uint32([[0, 1, 2], [0, 2, 5]]).tobytes()
    whole = struct.pack("<HH", 0x041C, 4) + zlib.compress(body)
    (scene.parent / "clutter.serialized").write_bytes(whole + struct.pack("<QI", 0, 1))
    flat = '<string name="filename" value="clutter.serialized"/><boolean name="face_normals" value="true"/>'
    edit(scene, "</scene>", f'<shape type="serialized" id="clutter">{flat}</shape></scene>')
    assert "clutter: expected a mesh of triangles between its own vertices, found a face of vertex 5 of 4" in refusal(scene)


def test_a_mesh_without_faces_is_refused_and_leaves_no_trace(scene):
    """Mitsuba calls every mesh of the process, so that one without faces fails in every scene as long as it exists."""
    whole = scene.read_text()
    (scene.parent / "clutter.obj").write_text("v 50 0 0\nv 51 0 0\nv 50 1 0\n")
    flat = '<string name="filename" value="clutter.obj"/><boolean name="face_normals" value="true"/>'
    edit(scene, "</scene>", f'<shape type="obj" id="clutter">{flat}</shape></scene>')
    with pytest.raises(
        cg.InputError, match="clutter: expected a mesh of triangles between its own vertices, found one without faces"
    ) as error:
        sim.load(scene)
    scene.write_text(whole)
    assert sim.load(scene).geometry.distance_m > 0
    assert error.value.__traceback__  # its frames are alive, as in a notebook after an error


def test_transparent_pictures_are_refused(scene):
    """Mitsuba takes transparent pixels for opaque ones: a letter on a transparent background would be a white square."""
    picture = np.full((32, 32, 4), 255, np.uint8)
    picture[:, :20, 3] = 0
    Image.fromarray(picture).save(scene.parent / "clutter.png")
    edit(
        scene,
        "</scene>",
        '<shape type="sphere"><transform name="to_world"><translate x="60"/></transform>'
        f'<bsdf type="diffuse">{TEXTURE}<string name="filename" value="clutter.png"/></texture></bsdf></shape></scene>',
    )
    assert "clutter.png: expected a picture without transparent pixels" in refusal(scene)


def test_every_file_that_a_scene_reads_changes_its_digest(scene):
    mesh = scene.parent / "clutter.obj"
    mesh.write_text("v 50 0 0\nv 51 0 0\nv 50 1 0\nf 1 2 3\n")
    (scene.parent / "textures").mkdir()
    write_exr(scene.parent / "textures" / "clutter.exr", np.full((8, 8), 0.3))
    edit(
        scene,
        "</scene>",
        '<shape type="obj"><string name="filename" value="clutter.obj"/></shape>'
        '<shape type="sphere"><transform name="to_world"><translate x="60"/></transform>'
        f'<bsdf type="diffuse">{TEXTURE}<string name="filename" value="clutter.exr"/></texture></bsdf></shape></scene>',
    )
    content = scene.read_text()
    start = content.index(">", content.index("<scene")) + 1
    scene.write_text(content[:start] + '<path value="textures"/>' + content[start:])
    digests = [sim.load(scene).digest]
    mesh.write_text("v 50 0 0\nv 51 0 0\nv 50 2 0\nf 1 2 3\n")
    digests.append(sim.load(scene).digest)
    write_exr(scene.parent / "textures" / "clutter.exr", np.full((8, 8), 0.4))
    digests.append(sim.load(scene).digest)
    assert len(set(digests)) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["transmission", "quantum_efficiency"])
def test_a_camera_that_collects_nothing_is_dark(scene, name):
    content = scene.read_text()
    if f'name="{name}"' in content:
        line = next(one for one in content.splitlines() if f'name="{name}"' in one)
        edit(scene, line, f'<float name="{name}" value="0"/>')
    else:
        edit(scene, '<float name="magnification"', f'<float name="{name}" value="0"/><float name="magnification"')
    capture = cg.render(sim.load(scene), frames=1)
    assert not capture.frames[0].any()
    assert cg.predict(sim.load(scene)).floor_over_peak is None
