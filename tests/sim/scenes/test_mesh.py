"""Meshes: conversion, and a solid letter whose front is the painted one."""

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import trimesh

from data_gen.letters import letter, save_mesh
from scenes import scene_path
from sim.mesh import main
from sim.scene_file import load_scene
from sim.scene_reader import read_geometry


def test_stl_becomes_ply_in_metres(tmp_path, command):
    box = trimesh.creation.box((10.0, 4.0, 2.0))
    box.export(tmp_path / "box.stl")
    code, out, _ = command(main, tmp_path / "box.stl", tmp_path / "box.ply", "--unit-m", 0.001)
    assert code == 0
    assert "10 x 4 x 2 mm" in out
    found = trimesh.load(tmp_path / "box.ply", force="mesh")
    np.testing.assert_allclose(found.extents, [0.01, 0.004, 0.002], rtol=1e-6)
    assert found.volume == pytest.approx(8e-8, rel=1e-5)


def test_bad_meshes(tmp_path, command):
    (tmp_path / "torn.stl").write_bytes(b"solid nothing")
    for source, target, text in (("no.stl", "a.ply", "no "), ("torn.stl", "a.ply", "input"), ("torn.stl", "a.obj", ".ply")):
        code, _, err = command(main, tmp_path / source, tmp_path / target)
        assert code == 2
        assert text in err
        assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "a.ply").exists()


def test_a_solid_letter_shows_its_front_the_right_way_round(tmp_path):
    """The shipped mesh against the bitmap it was drawn from, in the frame's axes; R has no symmetry."""
    save_mesh(tmp_path / "R.ply", letter("R"), 0.003)
    mesh = trimesh.load(tmp_path / "R.ply", force="mesh")
    assert mesh.extents[2] == pytest.approx(0.003, rel=1e-3)
    geometry = read_geometry(load_scene(scene_path("glyph_mesh"))[0])
    seen = geometry.hidden_object.cell_means(1e-2 / 64, 64)
    bitmap = letter("R").reshape(64, 4, 64, 4).mean((1, 3)) / 255.0
    assert np.corrcoef(seen.ravel(), bitmap.ravel())[0, 1] > 0.9
    for wrong in (bitmap[::-1], bitmap[:, ::-1], bitmap[::-1, ::-1]):
        assert np.corrcoef(seen.ravel(), wrong.ravel())[0, 1] < 0.7


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["tilted_letter", "occluded_letter", "two_depths", "glyph_mesh", "strong_ambient", "long_standoff"]
)
def test_every_scene_can_be_planned(name):
    from sim.plan_report import make_plan

    plan = make_plan(read_geometry(load_scene(scene_path(name))[0]), 2)
    assert plan["warnings"] == []
    assert plan["predicted_error"] < 0.02
