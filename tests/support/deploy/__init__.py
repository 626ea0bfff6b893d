"""The images and the composition of deploy/."""
