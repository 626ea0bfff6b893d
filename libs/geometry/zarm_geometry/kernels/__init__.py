"""The compiled code of the geometry: plain functions over packed arrays that use no Python objects."""
