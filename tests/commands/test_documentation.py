"""Every Python block and every command of README and docs runs, smaller where it would take long; so does every example."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("mitsuba")

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial.md"
PAGES = [ROOT / "README.md", *sorted(page for page in (ROOT / "docs").glob("*.md") if page != TUTORIAL)]
PYTHON = [
    (page.name, number, block.split("```")[0])
    for page in PAGES
    for number, block in enumerate(page.read_text().split("```python\n")[1:])
]
COMMANDS = [
    line.split("  #")[0].strip()
    for page in PAGES
    for line in page.read_text().splitlines()
    if re.match(r"    (?:correlograph|python -m) ", line) and "COPY" not in line and "correlograph live" not in line
]
"""Commands in their order, without the live view, which runs until it is interrupted (tests/live)."""

SMALLER = {
    "200000": "2048",
    "--count 1000": "--count 2",
    "--sets shapes rendered": "--sets shapes --count 1 --levels 1",
    "[--json]": "--json",
    "--workers 8": "--workers 1 --quality fast",
    "-o WEIGHTS.safetensors": "-o WEIGHTS.safetensors --width 8 --steps 2 --batch 2",
}


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}


@pytest.mark.slow
@pytest.mark.parametrize(("page", "number", "block"), PYTHON, ids=[f"{page}-{number}" for page, number, _ in PYTHON])
def test_python_blocks_run(page, number, block, tmp_path, monkeypatch):
    if "dask_jobqueue" in block:
        pytest.importorskip("dask_jobqueue", reason="a SLURM cluster and the package dask-jobqueue")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, f"{page}, block {number}", "exec"), {})


@pytest.mark.slow
def test_commands_run_as_they_stand(tmp_path):
    """The documented commands run in their order in one folder, which contains their input; lab data may be missing."""
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    photographs, shots = tmp_path / "PHOTOGRAPHS", tmp_path / "shots"
    photographs.mkdir()
    shots.mkdir()
    rng = np.random.default_rng(2)
    for number in range(3):
        row, column = np.mgrid[:300, :400]
        grey = 90.0 + 60.0 * np.sign(np.sin(row / (9 + number)) + np.sin(column / 13)) + rng.normal(0, 4, row.shape)
        Image.fromarray(grey.clip(0, 255).astype(np.uint8)).save(photographs / f"{number}.png")
    lab = ROOT.parent / "shared" / "data" / "measured_autocorrelations"
    ran = 0
    for command in COMMANDS:
        for text, smaller in SMALLER.items():
            command = command.replace(text, smaller)
        if "FOLDER" in command and not lab.is_dir():
            continue
        if "OUT.zarr" in command and "data_gen " in command:
            shutil.rmtree(tmp_path / "OUT.zarr", ignore_errors=True)
        arguments = [sys.executable, *shlex.split(command.replace("FOLDER", str(lab)))[1:]]
        done = subprocess.run(arguments, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.stderr[-800:]}"
        ran += 1
        if command.startswith("python -m sim ") and not any(shots.iterdir()):
            _as_camera_files(tmp_path / "capture", shots)
            _as_camera_files(tmp_path / "capture", tmp_path / "captures" / "first")
            Image.open(sorted(lab.glob("F_*n50*.png"))[0] if lab.is_dir() else _autocorrelation(tmp_path)).save(
                tmp_path / "estimate.png"
            )
            _save_calibration_frames(tmp_path)
            _save_hdf5(tmp_path)
        if "noise-model" in command:
            (tmp_path / "DATASET").symlink_to(tmp_path / "OUT.zarr") if not (tmp_path / "DATASET").exists() else None
    assert ran >= 14


@pytest.mark.slow
def test_quoted_numbers_are_those_of_the_program():
    command = [sys.executable, "-m", "benchmarks.quoted_numbers", "--check"]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-800:]


@pytest.mark.slow
def test_tutorial_runs(tmp_path, monkeypatch):
    """Every command and the Python block of the tutorial run in their order; two independent captures agree."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    text = TUTORIAL.read_text()
    for line in text.splitlines():
        if line.startswith("    python -m") and "shots/" not in line:
            arguments = [sys.executable, *shlex.split(line.split("  #")[0])[1:]]
            done = subprocess.run(arguments, env=environment(), capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{line}: {done.stderr[-800:]}"
    values: dict[str, float] = {}
    exec(compile(text.split("```python\n")[1].split("```")[0], "tutorial", "exec"), values)
    assert values["pearson"] > 0.85


def _save_calibration_frames(folder: Path) -> None:
    shape = np.asarray(Image.open(next((folder / "shots").glob("*.png")))).shape
    for name, value in (("dark.tif", 90), ("flat.tif", 4000), ("mask.png", 255)):
        kind = np.uint8 if name == "mask.png" else np.uint16
        Image.fromarray(np.full(shape, value, kind)).save(folder / name)


def _save_hdf5(folder: Path) -> None:
    import h5py

    frames = [np.asarray(Image.open(file)) for file in sorted((folder / "shots").glob("*.png"))]
    with h5py.File(folder / "run7.h5", "w") as file:
        file["entry/data"] = np.stack(frames)


def _as_camera_files(capture: Path, shots: Path) -> None:
    from correlograph.files.exr_frames import read_frame

    shots.mkdir(parents=True, exist_ok=True)
    for number, file in enumerate(sorted(capture.glob("*.exr"))):
        counts = np.clip(read_frame(file)[0] * 40.0 + 100.0, 0.0, 65535.0).astype(np.uint16)
        Image.fromarray(counts).save(shots / f"shot_{number}.png")


def _autocorrelation(folder: Path) -> Path:
    from radiometry.autocorrelation import autocorrelate

    lags = autocorrelate(np.load(folder / "capture" / "truth.npy"))
    Image.fromarray((20 + 235 * lags / lags.max()).astype(np.uint8)).save(folder / "lags.png")
    return folder / "lags.png"


@pytest.mark.slow
@pytest.mark.parametrize("example", sorted(path.name for path in (ROOT / "examples").glob("*.py")))
def test_examples_run(example, tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / example)],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-800:]
