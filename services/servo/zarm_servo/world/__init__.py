"""What the servo knows of the robot's surroundings, and the check of motions in them."""
