"""The compiled code of the planner: plain functions over packed arrays, no Python object inside."""
