"""`python -m invert.evaluate`: compare methods on test sets; see `evaluation/evaluate.py`."""

from invert.evaluation.evaluate import main
from radiometry.errors import run_command

__all__ = ["main"]

if __name__ == "__main__":
    run_command(main)
