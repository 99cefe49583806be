"""`python -m radiometry.plan`: divide an exposure into frames (`correlograph.commands.exposure_plan`)."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("correlograph.commands.exposure_plan")
