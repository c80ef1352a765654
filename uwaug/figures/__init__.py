"""Sheets of pictures: the demo, scenes of one's own, published systems side by side."""

from uwaug.figures.comparison import compare

__all__ = ["compare"]
