"""What a motion keeps of the pose of the tip."""
