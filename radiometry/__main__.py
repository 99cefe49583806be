"""`python -m radiometry`: print the light budget and the noise of a scene (`correlograph.commands.light_budget`)."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("correlograph.commands.light_budget")
