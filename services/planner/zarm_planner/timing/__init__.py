"""Trajectories along paths: joint positions with time, velocity and acceleration."""
