"""What is drawn and printed of the results."""
