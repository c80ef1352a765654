"""Sheets of pictures: the demo, scenes of one's own, published systems side by side."""
