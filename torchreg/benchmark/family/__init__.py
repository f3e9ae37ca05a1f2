"""Every descriptor of the library alone, and fused with FPFH and with color, on real pairs of known truth."""
