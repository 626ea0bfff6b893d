"""Clients, stand-ins and whole stacks on ROS 2. Importing a module needs ROS."""
