"""What all benchmarks share: the study and its runner, kept rows, tables, times, intervals and the machine."""
