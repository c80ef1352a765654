"""What every room may use, and what knows none of them: refusals, files written whole, caches."""
