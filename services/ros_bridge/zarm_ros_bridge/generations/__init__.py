"""The generations of curobo_msgs in use, and what the bridge does differently for each.

`curobo_msgs/` has their definitions: a folder is named after the generations that it belongs to. `definitions` reads them,
`installed` finds out which of them is the package that is installed beside the bridge, and `a`, `b` and `c` are the adapters.
"""
