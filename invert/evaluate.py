"""`python -m invert.evaluate`: compare methods on test sets; the command is `invert.evaluation.evaluate`."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("invert.evaluation.evaluate")
