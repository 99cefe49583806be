"""`python -m correlograph`: the same as the command `correlograph`."""

from correlograph.cli import main

if __name__ == "__main__":
    main()
