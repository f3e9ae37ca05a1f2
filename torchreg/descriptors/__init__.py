"""Descriptors of the surroundings of every point: FPFH, PCFH, contrast and learned histograms, and their fusion."""
