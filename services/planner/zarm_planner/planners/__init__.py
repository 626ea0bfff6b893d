"""The planners: the interface, one file for each, and the registry in which one is chosen."""
