"""Geometry that knows nothing of registration: rigid transforms, Kabsch, 3x3 eigenvectors, Z order, sums."""
