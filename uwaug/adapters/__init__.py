"""uwaug inside of other libraries, each in a module of its own."""
