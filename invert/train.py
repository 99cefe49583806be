"""`python -m invert.train`: train a network; the command is `invert.training.train`."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("invert.training.train")
