"""The geometry of the robot and the world: what can collide, where it is, and distances."""
