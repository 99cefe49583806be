"""A process that may use one core only, as in many containers."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("mitsuba")

CODE = """
import os
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import numpy as np
from sim.scene import load
load("tilted_letter", albedo=np.eye(20, 30))
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not choose the cores of a process")
def test_an_albedo_is_written_and_read_on_one_core():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
