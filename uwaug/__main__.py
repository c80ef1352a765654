"""The command line, as `python -m uwaug`."""

from uwaug.cli.app import main

if __name__ == "__main__":
    main()
