"""`python -m invert.warm_starts`: precompute classical reconstructions (`invert.training.warm_starts`)."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("invert.training.warm_starts")
