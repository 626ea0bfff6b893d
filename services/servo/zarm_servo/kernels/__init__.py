"""Compiled parts of a step: called from a cycle that has just slept, one kernel costs far less than many NumPy calls."""
