"""The compiled code of the geometry: plain functions over packed arrays, no Python object inside."""
