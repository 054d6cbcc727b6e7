"""`python -m robustopt` is the command `robustopt`."""

from robustopt.cli import main

if __name__ == "__main__":
    main()
