"""Tools that every room may use and that know no room: refusals, files written whole, caches."""
