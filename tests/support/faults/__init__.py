"""Sources of faults, and what is checked afterwards."""
