"""The model held against real water: charts at known distances, tanks in rising turbidity."""
