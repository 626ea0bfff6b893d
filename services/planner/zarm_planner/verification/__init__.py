"""The last gate before a trajectory leaves the planner."""
