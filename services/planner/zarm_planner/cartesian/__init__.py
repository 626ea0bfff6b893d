"""Motions of the tip along a given curve: lines, arcs and paths."""
