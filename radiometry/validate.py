"""`python -m radiometry.validate`: compare the noise model with rendered and lab speckle; the command is `correlograph.commands.noise_validation`."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("correlograph.commands.noise_validation")
