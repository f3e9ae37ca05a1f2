"""What simulated scenes are made of, and the scanner that sees them."""
