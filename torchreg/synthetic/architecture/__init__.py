"""What stays where it is: halls with their shops, streets with their houses."""
