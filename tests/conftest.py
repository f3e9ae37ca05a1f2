"""Settings that all tests share."""

import os

from hypothesis import settings

# Some tests run with more threads than the machine has free cores: waiting threads should sleep, not spin.
# OpenMP reads this once, when torch loads it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# The same examples on every run, and no limit of time, since machines differ.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")
