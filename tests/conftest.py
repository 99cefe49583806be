"""Shared fixtures: lab data (skipped where absent), rendered scenes, synthetic measurements."""

from __future__ import annotations

import random
import time
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def measured() -> Path:
    """Folder of published lab autocorrelations."""
    folder = ROOT.parent / "shared" / "data" / "measured_autocorrelations"
    if not folder.is_dir():
        pytest.skip(f"lab data not at {folder}")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20201)


@pytest.fixture(scope="session")
def letter_simulation():
    """simulation(letter="F", exposure=...) of the reference scene, each made once."""
    pytest.importorskip("mitsuba")
    from functools import lru_cache

    from scenes import scene_path
    from sim.frame import Simulation
    from sim.scene_file import load_scene
    from sim.scene_reader import read_geometry

    @lru_cache(maxsize=16)
    def make(letter: str = "F", **definitions: str) -> Simulation:
        scene, _ = load_scene(scene_path("corner_letter"), {"albedo": f"{letter}.png", **definitions})
        return Simulation(read_geometry(scene))

    return make


@pytest.fixture
def command(capsys):
    """Run a command's main as a shell would; returns (exit code, stdout, stderr)."""
    from correlograph.command import run_command

    def run(main, *arguments) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            run_command(main, [str(argument) for argument in arguments])
        except SystemExit as stop:
            captured = capsys.readouterr()
            return int(stop.code or 0), captured.out, captured.err
        raise AssertionError("a command always exits")

    return run


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--until", type=float, help="time since the epoch after which tests that have not begun are skipped")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Shuffle the files of tests that may run out of time, differently every day, so that the same ones are not skipped again and again."""
    until = config.getoption("--until")
    if until is not None:
        files = sorted({item.path for item in items})
        random.Random(int(until // 86400)).shuffle(files)
        items.sort(key=lambda item: files.index(item.path))


def pytest_runtest_setup(item: pytest.Item) -> None:
    until = item.config.getoption("--until")
    if until is not None and time.time() > until:
        pytest.skip("no time left before --until")
