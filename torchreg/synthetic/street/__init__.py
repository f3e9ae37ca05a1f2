"""What a simulated campus road is made of."""
