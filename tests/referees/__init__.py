"""Models of our own making that share no code with the package, to judge it by."""
