"""The model held against charts at known distances in real water."""
