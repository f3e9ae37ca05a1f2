"""What the paper leaves open about its color block: how many bins, how wide, how heavy, which channels."""
