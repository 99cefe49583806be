"""Files of a user that have the names of outputs: every command leaves them byte for byte as they were."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

import correlograph as cg
from correlograph.cli import COMMANDS, dispatch
from correlograph.files.capture_folder import stage_capture
from correlograph.files.manifest import (
    MANIFEST,
    PARTIAL,
    are_intact,
    claim,
    is_own,
    own_files,
    record_temporary,
    remove_temporary,
)
from correlograph.files.output import LOCK, atomic, save_json, sole_writer

NAMES = """
albedo.npy albedo.png autocorrelation.npy samples.npy report.png result.json table.md captures.json
contact_sheet.png contact_sheet_of_my_wedding.png frame_0000.exr frame_0001.exr frame_0004.exr sim.json
truth.npy plan.png plan.json validation.json noise_statistics.png photon_budget.png lab_floor.png G.png G.ply
w.safetensors w.png w.json w.checkpoint.safetensors m.ply results.json pareto.png shapes.png thesis.partial
.capture-is-being-moved .correlograph-partial-1-x a/albedo.npy a/result.json b/samples.npy cells/notes.txt
preview.png cameras.json cameras.png track.csv track.json track.png rotation.csv rotation.json rotation.png scene.xml object.png scene.png
""".split()  # noqa: SIM905


def write_users_files(folder: Path) -> dict[str, bytes]:
    for number, name in enumerate(NAMES):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b'{"frames": 5}' if name == "sim.json" else f"my {number}".encode())
    return contents(folder)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    """Two small captures, a mesh and a dataset."""
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(3)
    for name in ("a", "b"):
        (folder / "captures" / name).mkdir(parents=True)
        np.save(folder / "captures" / name / "0.npy", rng.exponential(size=(200, 180)).astype(np.float32))
    dispatch(["data-gen", str(folder / "set.zarr"), "--source", "strokes", "--count", "64", "--workers", "1"])
    (folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    Image.fromarray(np.eye(32, dtype=np.uint8) * 255).save(folder / "object.png")
    (folder / "moving").mkdir()
    pattern = ndimage.gaussian_filter(rng.exponential(size=(220, 200)), 2.0)
    for number in range(4):
        np.save(folder / "moving" / f"{number}.npy", np.roll(pattern, 3 * number, 0)[20:].astype(np.float32))
    return folder


WRITING = {
    "new-scene": ["IN/object.png", "-o", "OUT"],
    "sim": ["corner_letter", "-o", "OUT", "--frames", "2"],
    "sim --plan": ["corner_letter", "-o", "OUT", "--plan"],
    "plan": ["corner_letter", "-o", "OUT", "--budget-s", "1"],
    "plan cameras": ["corner_letter", "-o", "OUT", "--cameras", "--magnification", "0.5", "--binning", "1"],
    "validate": ["-o", "OUT"],
    "invert": ["IN/captures/a", "-o", "OUT", "--method", "er"],
    "track": ["IN/moving", "-o", "OUT"],
    "track rotation": ["IN/moving", "-o", "OUT", "--rotation"],
    "invert many": ["IN/captures", "-o", "OUT", "--method", "er", "--workers", "1"],
    "letters": ["OUT", "G"],
    "letters mesh": ["OUT", "G", "--mesh-depth-m", "0.001"],
    "mesh": ["IN/m.obj", "OUT/m.ply"],
    "preview": ["IN/set.zarr", "-o", "OUT/preview.png"],
    "train": ["IN/set.zarr", "-o", "OUT/w.safetensors", "--steps", "1"],
    "evaluate": ["-o", "OUT", "--sets", "shapes", "--methods", "er:fast", "--count", "1", "--levels", "1"],
}
WITHOUT_OUTPUT = {"radiometry", "doctor"}
OTHER_RULES = {"data-gen", "warm-starts", "calibrate", "live"}
"""The first two refuse any store or folder that is not theirs; calibrate changes the file that it reads; live saves into new folders."""


def test_every_command_is_covered():
    assert {name.split()[0] for name in WRITING} | WITHOUT_OUTPUT | OTHER_RULES == set(COMMANDS)


@pytest.mark.parametrize("name", WRITING)
def test_users_files_stay(name, inputs, tmp_path, command):
    before = write_users_files(tmp_path)
    arguments = [item.replace("OUT", str(tmp_path)).replace("IN", str(inputs)) for item in WRITING[name]]
    code, _, error = command(dispatch, name.split()[0], *arguments)
    assert contents(tmp_path) == before
    assert code == 2
    assert "--overwrite" in error
    assert len(error.splitlines()) == 1


def test_overwrite_replaces_what_it_names_and_nothing_else(tmp_path, command):
    before = write_users_files(tmp_path)
    code, _, error = command(dispatch, "sim", "corner_letter", "-o", tmp_path, "--frames", "1", "--overwrite")
    assert code == 0
    replaced = {"frame_0000.exr", "frame_0001.exr", "frame_0004.exr", "sim.json", "truth.npy", ".capture-is-being-moved"}
    assert all(name in error for name in replaced)
    after = contents(tmp_path)
    assert {name: after.get(name) for name in before if name not in replaced} == {
        name: content for name, content in before.items() if name not in replaced
    }
    assert [path.name for path in own_files(tmp_path)] == ["frame_0000.exr", "sim.json", "truth.npy"]


def test_stores_of_a_users_files_are_refused(tmp_path, command):
    before = write_users_files(tmp_path)
    code, _, _ = command(dispatch, "data-gen", tmp_path, "--source", "strokes", "--count", "8")
    assert code == 2
    assert contents(tmp_path) == before


def test_a_rerun_of_a_store_keeps_a_users_file(inputs, command):
    file = inputs / "set.zarr" / "thesis.partial"
    file.write_text("mine")
    code, _, error = command(
        dispatch, "data-gen", inputs / "set.zarr", "--source", "strokes", "--count", "64", "--workers", "1"
    )
    assert code == 0, error
    assert file.read_text() == "mine"


def test_a_file_is_own_until_it_is_changed(tmp_path):
    for name in ("plain.json", "two words.json", "back\\slash.json", "line\nbreak.json", os.fsdecode(b"latin-\xe9.json")):
        path = tmp_path / name
        save_json(path, {"a": 1})
        assert is_own(path)
        assert are_intact(tmp_path, [name])
        save_json(path, {"a": 2})
        path.write_text("changed")
        assert not is_own(path)
        assert not are_intact(tmp_path, [name])
        with pytest.raises(cg.InputError, match="overwrite"):
            save_json(path, {})
        assert path.read_text() == "changed"
    assert own_files(tmp_path) == []


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: path.symlink_to("target"), lambda path: os.mkfifo(path)])
def test_folders_links_and_pipes_are_never_replaced(tmp_path, make):
    make(tmp_path / "sim.json")
    for overwrite in (False, True):
        with pytest.raises(cg.InputError, match="folder, a link or a device"):
            claim(tmp_path, ["sim.json"], overwrite=overwrite)


def test_a_foreign_manifest_is_refused(tmp_path):
    (tmp_path / MANIFEST).write_text("my list\n")
    with pytest.raises(cg.InputError, match="manifest"):
        save_json(tmp_path / "a.json", {})
    assert (tmp_path / MANIFEST).read_text() == "my list\n"


def test_a_failed_write_leaves_the_earlier_file(tmp_path):
    save_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(TypeError), atomic(tmp_path / "a.json") as partial:
        partial.write_text(1)
    assert "1" in (tmp_path / "a.json").read_text()
    assert is_own(tmp_path / "a.json")
    assert sorted(path.name for path in tmp_path.iterdir()) == [MANIFEST, "a.json"]


def test_the_lock_excludes_processes_of_other_temporary_folders_and_vanishes(tmp_path):
    other = "import sys; from correlograph.files.output import sole_writer\nwith sole_writer(sys.argv[1]): pass"

    def enter() -> subprocess.CompletedProcess:
        environment = {**os.environ, "TMPDIR": str(tmp_path / "elsewhere")}
        return subprocess.run([sys.executable, "-c", other, str(tmp_path)], env=environment, capture_output=True, text=True)

    (tmp_path / "elsewhere").mkdir()
    with sole_writer(tmp_path):
        assert "no other process" in enter().stderr
    assert not (tmp_path / LOCK).exists()
    assert enter().returncode == 0


def test_the_lock_of_a_killed_process_does_not_last(tmp_path):
    kill = "import os, sys; from correlograph.files.output import sole_writer\nwith sole_writer(sys.argv[1]): os._exit(9)"
    assert subprocess.run([sys.executable, "-c", kill, str(tmp_path)], check=False).returncode == 9
    assert (tmp_path / LOCK).exists()
    with sole_writer(tmp_path):
        pass
    assert not (tmp_path / LOCK).exists()


def test_an_interrupted_run_leaves_no_manifest(tmp_path):
    with pytest.raises(KeyboardInterrupt), stage_capture(tmp_path / "new", 2):
        raise KeyboardInterrupt
    assert not any((tmp_path / "new").iterdir())
    with sole_writer(tmp_path / "kept"):
        save_json(tmp_path / "kept" / "a.json", {})
    with pytest.raises(KeyboardInterrupt), stage_capture(tmp_path / "kept", 2):
        raise KeyboardInterrupt
    assert is_own(tmp_path / "kept" / "a.json")


def test_a_capture_cannot_lead_out_of_the_output_folder(tmp_path, command):
    for name in ("...npy", "a.npy"):
        np.save(tmp_path / name, np.ones((127, 127), np.float32))
    code, _, error = command(
        dispatch, "invert", tmp_path / "...npy", tmp_path / "a.npy", "--autocorrelation", "-o", tmp_path / "out" / "deep"
    )
    assert code == 2
    assert "rename" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "line",
    [
        "temporary",
        "temporary  ",
        "temporary  notes.txt",
        "temporary  ../victim",
        "temporary  /tmp/victim",
        "temporary  .",
        "temporary  a\0b",
        f"{64 * '0'}  ../victim/notes.txt",
        "nonsense",
        "\xff\xfe",
    ],
)
def test_no_line_of_a_manifest_leads_to_a_users_file(tmp_path, line):
    """A manifest may be cut off, damaged or forged."""
    for folder in (tmp_path / "out", tmp_path / "victim"):
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
    header = "# files that correlograph wrote here\n"
    (tmp_path / "out" / MANIFEST).write_text(header + line, encoding="latin-1")
    with sole_writer(tmp_path / "out"):
        save_json(tmp_path / "out" / "a.json", {})
    assert is_own(tmp_path / "out" / "a.json")
    assert [path.name for path in own_files(tmp_path / "out")] == ["a.json"]
    assert all((tmp_path / name / "notes.txt").read_text() == "mine" for name in ("out", "victim"))


def test_manifests_that_are_no_files_are_refused(tmp_path):
    (tmp_path / "mine").touch()
    for number, make in enumerate((os.mkfifo, lambda path: path.symlink_to(tmp_path / "mine"), Path.mkdir)):
        folder = tmp_path / str(number)
        folder.mkdir()
        make(folder / MANIFEST)
        with pytest.raises(cg.InputError, match="manifest"):
            save_json(folder / "a.json", {})
    assert (tmp_path / "mine").read_bytes() == b""


def test_a_permission_ends_with_the_run_that_failed(tmp_path, command):
    np.save(tmp_path / "constant.npy", np.full((200, 200), 7.0))
    np.save(tmp_path / "lags.npy", np.ones((127, 127)))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.png").write_text("mine")
    output = ["-o", tmp_path / "out", "--method", "er", "--quality", "fast"]
    code, _, _ = command(dispatch, "invert", tmp_path / "constant.npy", *output, "--overwrite")
    assert code == 2
    script = "import sys; from correlograph.__main__ import main; main()"
    arguments = ["invert", tmp_path / "lags.npy", "--autocorrelation", *output]
    done = subprocess.run([sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--overwrite" in done.stderr
    assert (tmp_path / "out" / "report.png").read_text() == "mine"


def test_a_failed_run_leaves_the_earlier_result_whole(tmp_path, monkeypatch):
    """The disk fills up at each file in turn: result.json and all that it describes stay as they were."""
    from invert.output import result_files

    rng = np.random.default_rng(0)
    result = cg.reconstruct(cg.Capture([rng.poisson(4.0, (300, 300)).astype(np.float32) for _ in range(2)]), quality="fast")
    folder = tmp_path / "result"
    result.save(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != MANIFEST}
    for function in ("save_array", "save_image", "save_figure", "save_json"):

        def full(*_, **__):
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patched:
            patched.setattr(result_files, function, full)
            with pytest.raises(OSError, match="No space"):
                result.save(folder)
        assert {path.name: path.read_bytes() for path in folder.iterdir() if path.name != MANIFEST} == before


def test_a_running_process_keeps_its_unfinished_files(tmp_path):
    """Files of another output whose name ends alike, and files of a process that is alive, are not remains."""
    alive, dead = os.getppid(), 2**22 + 1
    for process, name in ((alive, "w.json"), (dead, "x-w.json"), (dead, "w.json")):
        path = tmp_path / f"{PARTIAL}{process}-{name}"
        path.write_text("part")
        record_temporary(path)
    remove_temporary(tmp_path, "w")
    left = {path.name.removeprefix(PARTIAL) for path in tmp_path.iterdir() if path.name.startswith(PARTIAL)}
    assert left == {f"{alive}-w.json", f"{dead}-x-w.json"}
    remove_temporary(tmp_path)
    left = {path.name.removeprefix(PARTIAL) for path in tmp_path.iterdir() if path.name.startswith(PARTIAL)}
    assert left == {f"{alive}-w.json"}
