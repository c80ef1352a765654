"""A page to try it: the model in one HTML file, for a browser."""
