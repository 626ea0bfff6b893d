"""Timed trajectories of joints: quintic samples, limits, blending, retiming."""
