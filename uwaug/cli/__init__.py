"""The command line, `uwaug …`. It computes nothing."""
