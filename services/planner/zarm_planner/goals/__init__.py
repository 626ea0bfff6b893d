"""Where a motion starts and where it may go."""
