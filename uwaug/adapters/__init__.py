"""`RandomUnderwater` inside of other libraries' pipelines: Albumentations, Hugging Face datasets,
WebDataset. Each has a module of its own.
"""
