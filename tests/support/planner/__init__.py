"""The planner: a client, small robots and problems, independent checks, and other planners to compare with."""
