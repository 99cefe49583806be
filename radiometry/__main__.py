"""`python -m radiometry`: a scene's light budget and noise; the command is `correlograph.commands.light_budget`."""

from correlograph.command import run_module

if __name__ == "__main__":
    run_module("correlograph.commands.light_budget")
