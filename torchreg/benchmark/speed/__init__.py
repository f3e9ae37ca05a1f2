"""Times and memory of every stage against Open3D, over numbers of points, neighbors and hypotheses."""
