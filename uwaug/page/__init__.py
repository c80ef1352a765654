"""The model in one HTML page, for a browser."""
