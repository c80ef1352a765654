"""Adapters of uwaug for other libraries, a module each."""
