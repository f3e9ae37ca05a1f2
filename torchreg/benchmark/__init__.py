"""Measurements that anyone can repeat: the experiments of the paper, the field on real scans, speed."""
