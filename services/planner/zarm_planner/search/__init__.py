"""Free paths: joint positions without time."""
