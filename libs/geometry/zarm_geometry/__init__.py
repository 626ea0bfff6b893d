"""The geometry of the robot and the world: what collides, where it is, and distances."""
