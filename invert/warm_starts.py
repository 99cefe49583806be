"""`python -m invert.warm_starts`: classical reconstructions to train the fusion with; see `training/warm_starts.py`."""

from invert.training.warm_starts import main
from radiometry.errors import run_command

__all__ = ["main"]

if __name__ == "__main__":
    run_command(main)
