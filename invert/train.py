"""`python -m invert.train`: train a network; see `training/train.py`."""

from invert.training.train import main
from radiometry.errors import run_command

__all__ = ["main"]

if __name__ == "__main__":
    run_command(main)
