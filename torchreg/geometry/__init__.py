"""Geometry below registration: rigid transforms, Kabsch, 3x3 eigenvectors, Z order, numerics."""
