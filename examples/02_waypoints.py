"""One motion through several poses, without a stop at any of them."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
DOWN = (0.0, 1.0, 0.0, 0.0)

with zarm.connect() as robot:
    robot.execute(robot.plan(HOME))

    corners = [(0.5, -0.2, 0.5), (0.6, 0.0, 0.4), (0.5, 0.2, 0.5)]
    plan = robot.plan(zarm.Waypoints(*(zarm.Pose(corner, DOWN) for corner in corners), HOME))
    print("passes its waypoints at", *(f"{time:.2f} s" for time in plan.waypoint_times))

    print(robot.execute(plan).status)
