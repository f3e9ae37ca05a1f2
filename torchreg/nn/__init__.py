"""Modules over the functions: they hold options and learnable weights, and nothing else."""
