"""The drivers of a robot, its grippers and its outputs on ROS: their topics, actions and services, to and from `driver/*` on the bus."""
