"""Links that are cut, routers that stall, and two machines on one."""
