"""Sheets of pictures: the demo, the user's scenes, published systems side by side."""
