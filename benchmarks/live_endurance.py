"""`python -m benchmarks.live_endurance -o FOLDER`: memory of the live view while its source misbehaves.

`correlograph live` follows a folder to which frames of 5 megapixels are added. At random, files are damaged, replaced, deleted or
of another size, and the folder is deleted and made again. A line per minute states the memory of the process and the number of events.
The last line states the highest memory, and whether the process still runs and ends cleanly.
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import tifffile

import correlograph as cg

SHAPE = (2056, 2464)
EVENTS = ("frame", "damaged", "replaced", "deleted", "other size", "not finite", "folder deleted")
WEIGHTS = (0.85, 0.04, 0.04, 0.03, 0.02, 0.01, 0.01)
OPTIONS = ("--pixel-pitch-m", "6.9e-6", "--wavelength-m", "532e-9", "--distance-m", "1", "--exposure-s", "0.125")


class Recorder:
    """Writes frames, and damages what it wrote."""

    def __init__(self, folder: Path, frames: list[np.ndarray], seed: int) -> None:
        self.folder, self._frames, self._rng, self._count = folder, frames, np.random.default_rng(seed), 0
        self.events: Counter[str] = Counter()

    def act(self) -> None:
        """Do one thing at random."""
        event = str(self._rng.choice(EVENTS, p=WEIGHTS))
        self.events[event] += 1
        self._count += 1
        if event == "folder deleted":
            shutil.rmtree(self.folder)
            time.sleep(3.0)
        self.folder.mkdir(exist_ok=True)
        files = sorted(self.folder.glob("*.tif"))[-5:]
        old = files[self._rng.integers(len(files))] if files else self.folder / "first.tif"
        new = self.folder / f"{self._count:06d}.tif"
        if event == "deleted":
            old.unlink(missing_ok=True)
        elif event == "damaged":
            new.write_bytes(self._rng.bytes(10000))
        elif event == "other size":
            self._write(new, self._frame()[:-16])
        elif event == "not finite":
            self._write(new, np.where(self._rng.random(SHAPE) < 1e-6, np.nan, self._frame()).astype(np.float32))
        else:
            self._write(old if event == "replaced" else new, self._frame())

    def _frame(self) -> np.ndarray:
        """Return a frame with photon noise of its own."""
        light = self._frames[self._count % len(self._frames)]
        return self._rng.poisson(light[:: self._rng.choice([-1, 1])]).astype(np.uint16)

    def _write(self, file: Path, frame: np.ndarray) -> None:
        staged = file.with_suffix(".partial")
        tifffile.imwrite(staged, frame)
        staged.replace(file)


def resident_mb(process: int) -> float:
    """Return the memory of a process in MB (Linux)."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
    return int(found[1]) / 1024.0 if found else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--interval-s", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    folder = options.output / "frames"
    folder.mkdir(parents=True)
    frames = [10.0 * frame / frame.mean() for frame in cg.render("corner_letter", frames=4, seed=options.seed).frames]
    recorder = Recorder(folder, frames, options.seed)
    command = [sys.executable, "-m", "correlograph", "live", str(folder), "-o", str(options.output / "saved"), *OPTIONS]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    print(process.stdout.readline().strip(), flush=True)
    begin, highest, minute = time.monotonic(), 0.0, 0
    while process.poll() is None and time.monotonic() - begin < 60.0 * options.minutes:
        recorder.act()
        time.sleep(options.interval_s)
        for file in sorted(folder.glob("*.tif"))[:-20]:
            file.unlink()
        highest = max(highest, resident_mb(process.pid))
        if time.monotonic() - begin > 60.0 * minute:
            minute += 1
            print(f"{minute} min: {resident_mb(process.pid):.0f} MB, {dict(recorder.events)}", flush=True)
    runs = process.poll() is None
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    print(f"highest {highest:.0f} MB; running at the end: {runs}; exit status {process.returncode}; said: {said.strip()!r}")


if __name__ == "__main__":
    main()
