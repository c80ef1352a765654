"""Placeholder until the branch `light` is merged."""


class Light:
    """See branch `light`."""
