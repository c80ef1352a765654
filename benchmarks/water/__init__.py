"""The model held against real water at known distances."""
