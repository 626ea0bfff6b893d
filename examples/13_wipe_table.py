"""Wipe a table: lane by lane on straight lines with rounded corners, at one height, and with any turn of the cloth."""

import zarm

DOWN = (0.0, 1.0, 0.0, 0.0)
HEIGHT, LANES = 0.345, 5

with zarm.connect() as robot:
    robot.scene.clear()
    robot.scene.add(zarm.Cuboid("table", size=(0.5, 0.7, 0.05), position=(0.6, 0.0, 0.28)))

    robot.execute(robot.plan(zarm.PoseGoal(zarm.Pose((0.45, -0.2, HEIGHT), DOWN), free=["theta_z"])))
    points = []
    for lane in range(LANES):
        x = 0.45 + 0.06 * lane
        ends = [(x, -0.2, HEIGHT), (x, 0.2, HEIGHT)]
        points += ends if lane % 2 == 0 else reversed(ends)

    plan = robot.plan(zarm.Path(*points[1:], blend=0.02, speed=0.2, free=["theta_z"]))
    print(f"{plan.tool.length:.2f} m in {plan.trajectory.duration:.1f} s")
    print(f"at {plan.tool.speed} m/s on {plan.tool.speed_share * 100:.0f} % of the way")
    print(robot.execute(plan).status)
    robot.scene.clear()
