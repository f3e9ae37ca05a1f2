"""Registration methods under one contract, torchreg's and its peers', so that all get the same clouds."""

from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task
from torchreg.benchmark.peers.registry import METHODS, NOT_HERE, chosen_methods

__all__ = ["METHODS", "NOT_HERE", "Answer", "Method", "PeerMatches", "Task", "chosen_methods"]
