"""`python -m uwaug`."""

from uwaug.cli import main

if __name__ == "__main__":
    main()
