"""The command line, `uwaug …`."""
