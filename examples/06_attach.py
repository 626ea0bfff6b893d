"""Pick a box up, carry it past a wall, and put it down: what the robot carries is planned for too."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
DOWN = (0.0, 1.0, 0.0, 0.0)

with zarm.connect() as robot:
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    robot.execute(robot.plan(zarm.Pose((0.5, -0.3, 0.3), DOWN)))

    robot.scene.add(zarm.Cuboid("box", size=(0.08, 0.08, 0.1), position=(0.5, -0.3, 0.24)))
    robot.scene.attach("box", touch_links=["link_6"])
    print("the robot carries:", ", ".join(robot.scene.attached()))

    robot.scene.add(zarm.Cuboid("wall", size=(0.6, 0.02, 0.3), position=(0.6, 0.0, 0.15)))
    plan = robot.plan(zarm.Pose((0.5, 0.3, 0.3), DOWN))
    print(f"over the wall, the box included, with {plan.clearance * 1e3:.0f} mm to spare: {robot.execute(plan).status}")

    robot.scene.detach("box")
    box = robot.scene.objects()["box"]
    print("the box stands at", *(f"{x:.2f}" for x in box.position), "m")
    robot.scene.clear()
