"""`python -m invert.calibrate`: calibrate the confidence of a network; the command is `invert.training.calibration`."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("invert.training.calibration")
