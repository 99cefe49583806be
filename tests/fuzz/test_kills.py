"""Every command that takes long: killed or interrupted at random moments, then run again to the same bytes.

`make fuzz` stops each of them many times (FUZZ_KILLS); the short run a few times.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from correlograph.files.exr_frames import read_frame
from correlograph.files.manifest import MANIFEST
from correlograph.files.output import LOCK, PARTIAL
from invert.choices import DEFAULT_WEIGHTS
from invert.network.checkpoints import read_weights

ROOT = Path(__file__).parents[2]
STOPS = int(os.environ.get("FUZZ_KILLS", "2"))
EACH = 5
"""Stops before a run is let to its end."""
SEED = int(os.environ.get("FUZZ_SEED", "0"))
COMMANDS = ("sim", "data_gen", "invert", "invert of many captures", "invert.train", "invert.warm_starts", "invert.evaluate")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    from data_gen.__main__ import main

    store = tmp_path_factory.mktemp("targets") / "set.zarr"
    main([str(store), "--source", "strokes", "--count", "1600", "--workers", "1"])
    return store


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    from sim.__main__ import main

    folder = tmp_path_factory.mktemp("frames")
    main(["corner_letter", "-o", str(folder), "-D", "exposure=0.01"])
    return folder


def arguments(name: str, output: Path, dataset: Path, capture: Path) -> list[str]:
    return {
        "sim": ["corner_letter", "-o", output, "--frames", 6],
        "data_gen": [output, "--source", "mixed", "--count", 5000, "--workers", 2, "--measurement", "noise-model"],
        "invert": [capture, "-o", output],
        "invert of many captures": [several(capture), "-o", output, "--quality", "fast", "--workers", 2],
        "invert.train": [
            dataset,
            "-o",
            output / "w.safetensors",
            "--width",
            32,
            "--steps",
            8,
            "--batch",
            2,
            "--checkpoint-every",
            2,
        ],
        "invert.warm_starts": [dataset, "-o", output, "--weights", DEFAULT_WEIGHTS, "--count", 64],
        "invert.evaluate": ["-o", output, "--sets", "shapes", "--methods", "er:fast", "hio:fast", "--count", 2, "--levels", 3],
    }[name]


def several(capture: Path) -> Path:
    """A folder of six captures, of one frame each."""
    folder = capture.parent / "several"
    for number in range(6):
        (folder / str(number)).mkdir(parents=True, exist_ok=True)
        frame = read_frame(capture / "frame_0000.exr")[0]
        if not (folder / str(number) / "frame.npy").exists():
            np.save(folder / str(number) / "frame.npy", np.roll(frame, 7 * number, 1))
    return folder


def result(output: Path) -> dict[str, object]:
    """Return the output of a finished command without timings and manifests."""
    found: dict[str, object] = {}
    for path in sorted(output.rglob("*")):
        if path.is_dir() or path.suffix in (".png", ".md") or path.name == MANIFEST:
            continue
        name = str(path.relative_to(output))
        if path.suffix == ".json" and path.name != "zarr.json":
            found[name] = timeless(json.loads(path.read_text()))
        elif path.suffix == ".safetensors":
            found[name] = {key: value.tolist() for key, value in read_weights(path)[0].items()}
        elif path.suffix == ".exr":
            found[name] = read_frame(path)[0].tobytes()
        else:
            found[name] = path.read_bytes()
    return found


def timeless(content):
    if isinstance(content, dict):
        return {key: timeless(value) for key, value in content.items() if "second" not in key}
    return [timeless(value) for value in content] if isinstance(content, list) else content


def start(name: str, given: list, run: str) -> subprocess.Popen:
    """A command of its own, its whole family to be known by a variable of its environment."""
    command = [sys.executable, "-m", name.split()[0], *map(str, given)]
    return subprocess.Popen(
        command,
        cwd=ROOT,
        text=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "TEST_RUN": run},
        start_new_session=True,
    )


def run_to_its_end(name: str, given: list) -> None:
    process = start(name, given, "")
    err = process.communicate()[1]
    assert process.returncode == 0, err


def living(run: str) -> list[int]:
    """Processes of a run that are still there."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if (
                f"TEST_RUN={run}".encode() in (folder / "environ").read_bytes().split(b"\0")
                and ") Z " not in (folder / "stat").read_text()
            ):
                found.append(int(folder.name))
        except OSError:
            continue
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_stopped_at_any_moment_and_run_again(name, tmp_path, dataset, capture):
    """SIGKILL, SIGINT and SIGTERM at moments drawn over the whole run; after every few, an undisturbed run to the end."""
    rng = random.Random(f"{SEED} {name}")
    (tmp_path / "whole").mkdir()
    begin = time.monotonic()
    run_to_its_end(name, arguments(name, tmp_path / "whole", dataset, capture))
    lasts_s = time.monotonic() - begin
    expected = result(tmp_path / "whole")
    for stop in range(STOPS):
        output = tmp_path / f"stopped-{stop // EACH}"
        output.mkdir(exist_ok=True)
        run, left_by_kills = uuid.uuid4().hex, set(output.rglob(f"{PARTIAL}*"))
        process = start(name, arguments(name, output, dataset, capture), run)
        time.sleep(rng.uniform(0.0, lasts_s))
        number = rng.choice((signal.SIGKILL, signal.SIGINT, signal.SIGINT, signal.SIGTERM))
        if rng.random() < 0.5 and number == signal.SIGINT:
            os.killpg(process.pid, number)  # as the keyboard does
        else:
            process.send_signal(number)
        err = process.communicate(timeout=60)[1]
        # -number: before the interpreter had begun with our code; 0: it had already ended.
        assert process.returncode in (0, 128 + number, -number), err
        assert ("Traceback" if process.returncode != -number else str(ROOT)) not in err, err
        if process.returncode == 128 + number:
            assert err.rstrip().splitlines()[-1] == "interrupted", err
            assert set(output.rglob(f"{PARTIAL}*")) <= left_by_kills
            # an earlier kill may have left a lock, but this process may not
            assert not [lock for lock in tmp_path.rglob(f"{LOCK}*") if lock.read_text().startswith(f"{process.pid}\n")]
        deadline = time.monotonic() + 30.0
        while living(run) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not living(run)
        if stop % EACH == EACH - 1 or stop == STOPS - 1:
            run_to_its_end(name, arguments(name, output, dataset, capture))
            assert result(output) == expected
            assert not [path for pattern in (f"{PARTIAL}*", "*.partial") for path in output.rglob(pattern)]


def test_the_second_of_two_processes_on_one_output_is_refused(tmp_path, dataset, capture):
    for name in COMMANDS:
        given = arguments(name, tmp_path / name, dataset, capture)
        (tmp_path / name).mkdir()
        first, second = start(name, given, ""), start(name, given, "")
        errors = [process.communicate()[1] for process in (first, second)]
        codes = sorted(process.returncode for process in (first, second))
        assert codes in ([0, 2], [0, 0]), errors  # 0, 0: one had ended before the other began to write
        if codes == [0, 2]:
            assert "no other process is writing" in "".join(errors)
