"""What MoveIt's move_group serves: planning, execution, kinematics and the planning scene."""
