"""Path constraints on the pose of the tip."""
