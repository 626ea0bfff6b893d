"""An obstacle from a file of triangles. The planner reads it: start it with `zarm up --meshes examples/meshes`."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
DOWN = (0.0, 1.0, 0.0, 0.0)

with zarm.connect() as robot:
    robot.scene.clear()
    robot.execute(robot.plan(HOME))

    robot.scene.add(zarm.Mesh("wedge", file="wedge.obj", position=(0.55, 0.3, 0.0), scale=1.5))
    wedge = robot.scene.objects()["wedge"]
    print(f"the planner has read it: {wedge}")

    plan = robot.plan(zarm.Waypoints(zarm.Pose((0.4, 0.5, 0.4), DOWN), HOME))
    print(f"past it with {plan.clearance * 1e3:.0f} mm to spare: {robot.execute(plan).status}")
    robot.scene.remove("wedge")
