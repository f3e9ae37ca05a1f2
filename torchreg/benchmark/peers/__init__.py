"""Registration methods under one contract, this library's own and its peers', so that all get the same clouds."""

from torchreg.benchmark.peers.method import Answer, Matched, Method, Task
from torchreg.benchmark.peers.registry import METHODS, NOT_HERE, chosen_methods

__all__ = ["METHODS", "NOT_HERE", "Answer", "Matched", "Method", "Task", "chosen_methods"]
