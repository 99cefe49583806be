"""`python -m invert.calibrate`: calibrate a network's confidence; see `training/calibration.py`."""

from invert.training.calibration import main
from radiometry.errors import run_command

__all__ = ["main"]

if __name__ == "__main__":
    run_command(main)
