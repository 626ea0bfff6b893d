"""Sessions, in which the robot follows a live target."""
