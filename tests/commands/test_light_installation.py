"""Reconstruction and live view without the optional packages; everything else names the group that installs them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from correlograph.errors import EXTRAS, InputError, missing_package
from tests.light import speckle

BLOCK = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {set(EXTRAS)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""
"""Code that makes all optional packages absent."""

ROOT = Path(__file__).parents[2]


def run(code: str, *arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", BLOCK + code, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def command(*arguments: object) -> subprocess.CompletedProcess:
    return run("from correlograph.cli import main; main()", *arguments)


@pytest.fixture
def frames(tmp_path):
    albedo = np.zeros((64, 64), np.float32)
    albedo[20:44, 25:29] = albedo[20:24, 25:41] = 1.0
    rng = np.random.default_rng(1)
    np.save(tmp_path / "frames.npy", np.stack([speckle(albedo, (400, 460), rng) for _ in range(2)]).astype(np.float32))
    return tmp_path / "frames.npy"


def test_frames_are_reconstructed(frames, tmp_path):
    done = command("invert", frames, "-o", tmp_path / "out", "--quality", "fast")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "result.json").read_text())["object_found"]


def test_the_live_view_saves_frames(frames, tmp_path):
    code = """
import numpy as np
import correlograph as cg
from correlograph.live.session import LiveSession
session = LiveSession(cg.CameraMetadata(532e-9, 7e-6, 1.0), 0.1)
for frame in np.load(sys.argv[1]): session.add(frame)
assert session.report(session.estimate()).detection > 6.0
from pathlib import Path
print(session.save(Path(sys.argv[2])))
"""
    done = run(code, frames, tmp_path / "saved")
    assert done.returncode == 0, done.stderr
    assert np.load(tmp_path / "saved" / "capture_001" / "frames.npy").shape == (2, 400, 460)


@pytest.mark.parametrize(
    ("arguments", "group"),
    [
        (("sim", "corner_letter", "--plan"), "sim"),
        (("radiometry", "corner_letter"), "sim"),
        (("plan", "corner_letter", "--budget-s", "1", "-o", "OUT"), "sim"),
        (("data-gen", "OUT/set.zarr", "--source", "strokes", "--count", "64"), "data"),
        (("invert", "OUT/frame.exr", "-o", "OUT/result"), "files"),
        (("invert", "FRAMES", "-o", "OUT/result", "--scheduler", "tcp://127.0.0.1:1"), "cluster"),
    ],
)
def test_commands_name_the_group_that_they_need(arguments, group, frames, tmp_path):
    (tmp_path / "frame.exr").write_bytes(b"no picture")
    done = command(*(item.replace("OUT", str(tmp_path)).replace("FRAMES", str(frames)) for item in arguments))
    assert done.returncode == 2, done.stderr
    assert f"correlograph[{group}]" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_python_names_it_as_well():
    done = run("import correlograph as cg; cg.load('corner_letter')")
    assert "InputError" in done.stderr.splitlines()[-1]
    assert "correlograph[sim]" in done.stderr
    assert isinstance(missing_package(ModuleNotFoundError("x", name="dask.base")), InputError)
    other = ModuleNotFoundError("x", name="nothing")
    assert missing_package(other) is other
