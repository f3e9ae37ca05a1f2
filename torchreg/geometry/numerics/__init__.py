"""Rows in pieces, sums in a fixed order, kernels compiled on demand, work shared out among threads."""
