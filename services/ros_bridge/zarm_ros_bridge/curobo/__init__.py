"""What curobo_ros serves: the services, actions and parameters of `unified_planner`, in the types of `curobo_msgs`."""
