"""The compiled code of the import; `zarm_geometry.kernels.compiled` describes how it is cached."""
