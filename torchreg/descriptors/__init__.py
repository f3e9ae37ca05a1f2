"""What a point's surroundings look like: FPFH, PCFH, contrast and learned histograms, and their fusion."""
