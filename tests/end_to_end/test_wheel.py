"""The installed wheel renders and reconstructs outside the checkout, in its own environment."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
INDEX = os.environ.get("TORCH_INDEX", "https://download.pytorch.org/whl/cpu")


INSTALLATION_S = 600.0
"""Longest time for the packages that the program needs; a package index may be slow or out of reach."""


def run(*arguments: object, cwd: Path, timeout_s: float | None = None) -> subprocess.CompletedProcess:
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return subprocess.run(
        list(map(str, arguments)), cwd=cwd, env=clean, capture_output=True, text=True, check=False, timeout=timeout_s
    )


@pytest.mark.slow
def test_a_wheel_renders_and_inverts(tmp_path):
    source = shutil.copytree(ROOT, tmp_path / "source", ignore=shutil.ignore_patterns(".*", "out", "build", "*.egg-info"))
    built = run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", tmp_path, source, cwd=tmp_path)
    assert built.returncode == 0, built.stderr[-800:]
    wheel = next(tmp_path.glob("*.whl"))
    assert run(sys.executable, "-m", "venv", tmp_path / "new", cwd=tmp_path).returncode == 0
    python = tmp_path / "new" / "bin" / "python"
    pip = (python, "-m", "pip", "install", "--quiet", "--retries", 1, "--timeout", 30)
    try:  # the index of torch is asked for torch alone: if it does not answer, each package waits for it
        installed = run(*pip, "--extra-index-url", INDEX, "torch<2.14", cwd=tmp_path, timeout_s=INSTALLATION_S)
        if installed.returncode == 0:
            installed = run(*pip, f"{wheel}[all]", cwd=tmp_path, timeout_s=INSTALLATION_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"packages take longer than {INSTALLATION_S:.0f} s to install")
    if installed.returncode and "No matching distribution" in installed.stderr:
        pytest.skip(f"no package index within reach: {installed.stderr.strip().splitlines()[-1][:200]}")
    assert installed.returncode == 0, installed.stderr[-800:]
    command = tmp_path / "new" / "bin" / "correlograph"
    scene = run(python, "-c", "from scenes import scene_path; print(scene_path('corner_letter'))", cwd=tmp_path).stdout.strip()
    assert str(tmp_path) in scene
    for arguments in (
        ("doctor",),
        ("sim", scene, "-o", "frames", "--seed", 1),
        ("invert", "frames", "-o", "result", "--quality", "fast", "--truth", "frames/truth.npy"),
        ("radiometry", scene, "--json", "--samples", 20000),
    ):
        done = run(command, *arguments, cwd=tmp_path)
        assert done.returncode == 0, f"{arguments[0]}: {done.stderr[-800:]}"
    assert json.loads((tmp_path / "result" / "result.json").read_text())["pearson"] > 0.85
