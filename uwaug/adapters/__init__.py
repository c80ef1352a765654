"""`RandomUnderwater` inside of other libraries' pipelines, each in a module of its own."""
