"""The generations of curobo_msgs in use, and what the bridge does differently for each.

`curobo_msgs/` has their definitions: a folder is named after the generations to which it belongs. `definitions` reads
them, `installed` identifies the package installed beside the bridge, and `a`, `b` and `c` are the adapters.
"""
