"""An interrupted command ends in one line, whenever the interruption arrives, and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("mitsuba")

from scenes import scene_path

SCENE = scene_path("corner_letter")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after_s", [0.3, 0.8, 1.5, 2.5, 4.0, 6.0])
def test_an_interrupt_is_one_line_and_leaves_nothing_behind(tmp_path, number, after_s):
    arguments = [sys.executable, "-m", "sim", str(SCENE), "-o", str(tmp_path / "out"), "--frames", "40"]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ})
    time.sleep(after_s)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (128 + number, -number)  # -number: before the interpreter had begun with our code
    assert "Traceback" not in err or "run_command(" not in err  # the command itself had not begun
    assert not any(path.is_file() for path in (tmp_path / "out").rglob("*"))


def test_an_interrupt_ends_what_waits_for_ever():
    """A library that ignores the interrupt is ended after the grace period, without a message about its semaphore."""
    program = """
import multiprocessing, os, threading, time
import correlograph.command as command
command.GRACE_S = 1.0
def main(argv):
    semaphore = multiprocessing.get_context("spawn").Lock()
    threading.Timer(0.3, os.kill, (os.getpid(), 15)).start()
    while True:
        try:
            time.sleep(60)
        except KeyboardInterrupt:
            pass
command.run_command(main, [])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=30)
    assert (done.returncode, done.stderr) == (143, "interrupted\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_until_a_library_has_loaded(tmp_path, number):
    """An exception within the import of a compiled library can abort the process."""
    (tmp_path / "library.py").write_text(
        f"import os, time\nos.kill(os.getpid(), {number:d})\ntime.sleep(0.2)\nprint('loaded')\n"
    )
    program = """
import time
from correlograph.command import run_command
def main(argv):
    import library
    time.sleep(60)
run_command(main, [])
"""
    paths = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])
    settings = {"capture_output": True, "text": True, "check": False, "timeout": 30}
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": paths}, **settings)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "loaded\n", "interrupted\n")
    assert time.monotonic() - begin < 10.0  # not only after `GRACE_S`, although the command sleeps
