"""``python -m fg_orient``: the command line."""

from fg_orient.cli import main

if __name__ == "__main__":
    main()
