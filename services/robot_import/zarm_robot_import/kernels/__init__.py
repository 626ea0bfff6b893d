"""The compiled code of the import; `zarm_geometry.kernels.compiled` says how it is kept."""
