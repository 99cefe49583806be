"""Commands for lab computers run without the calls that only POSIX systems have. Not a substitute for a test on Windows."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

REMOVE = """
import importlib.abc, os, signal, sys

NAMES = ("getuid", "geteuid", "getgid", "getlogin", "fork", "forkpty", "sysconf", "sched_getaffinity", "killpg", "getpgid", "getpgrp",
         "setsid", "setpgid", "nice", "chown", "lchown", "mkfifo", "mknod", "getloadavg", "wait3", "wait4", "pread", "pwrite")
for name in NAMES:
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGKILL", "SIGPIPE", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGQUIT", "alarm", "setitimer", "pthread_kill"):
    if hasattr(signal, name):
        delattr(signal, name)


class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Missing())
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules.pop(name, None)
"""

RUN_INVERT = """
from invert.__main__ import main
from correlograph.command import run_command
sys.argv = ["invert", "frames.npy", "-o", "out", "--quality", "fast", "--patch", "150"]
run_command(main)
"""

RUN_PLAN = """
from correlograph.commands.exposure_plan import main
from correlograph.command import run_command
sys.argv = ["radiometry.plan", "corner_letter", "--budget-s", "1", "-o", "plan"]
run_command(main)
"""

RUN_LIVE = """
import numpy as np
from correlograph.files.capture import CameraMetadata
from correlograph.live.threads import Acquisition
from correlograph.live.session import LiveSession


class Camera:
    camera = CameraMetadata()

    def __iter__(self):
        yield from np.load("frames.npy")


acquisition = Acquisition(Camera(), LiveSession(Camera.camera))
acquisition.start()
acquisition.finished.wait(60)
acquisition.join()
assert acquisition.session.frames == 3, acquisition.problem
from pathlib import Path
acquisition.session.save(Path("saved"))
"""


@pytest.mark.parametrize(
    ("program", "made"),
    [(RUN_INVERT, "out/result.json"), (RUN_PLAN, "plan"), (RUN_LIVE, "saved")],
    ids=["invert", "plan", "live"],
)
def test_commands_need_no_posix_call(tmp_path: Path, program: str, made: str) -> None:
    rng = np.random.default_rng(4)
    np.save(tmp_path / "frames.npy", rng.poisson(4.0, (3, 300, 330)).astype(np.uint16))
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {root!r})\n{REMOVE}\n{program}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / made).exists()
