"""`python -m radiometry.validate`: compare the noise model with frames (`correlograph.commands.noise_validation`)."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("correlograph.commands.noise_validation")
