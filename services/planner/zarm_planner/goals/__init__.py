"""Start and goal configurations of a motion."""
