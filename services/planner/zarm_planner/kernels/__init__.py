"""The compiled code of the planner: plain functions over packed arrays that use no Python objects."""
