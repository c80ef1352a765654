"""Pictures and distance maps in files, read and written whole."""
