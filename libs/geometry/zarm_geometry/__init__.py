"""The robot's body and the world: what collides, where it is, and how far apart."""
