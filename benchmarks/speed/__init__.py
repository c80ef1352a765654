"""How long: ours beside others in one process."""
