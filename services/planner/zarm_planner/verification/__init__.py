"""Verification, the last step before a trajectory leaves the planner."""
