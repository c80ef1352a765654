"""A depth network of our own for distances that are made up: scenes, training, measures."""
