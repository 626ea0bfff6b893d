"""Pick a part from a bin: however the gripper is turned, but straight down and up again, and with the part on the way on."""

import zarm

DOWN = (0.0, 1.0, 0.0, 0.0)
HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
WALLS = {"left": (0.0, 0.16), "right": (0.0, -0.16), "front": (0.16, 0.0), "back": (-0.16, 0.0)}

with zarm.connect() as robot:
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    for name, (x, y) in WALLS.items():
        size = (0.02, 0.34, 0.15) if x else (0.34, 0.02, 0.15)
        robot.scene.add(zarm.Cuboid(name, size=size, position=(0.55 + x, 0.25 + y, 0.1)))
    robot.scene.add(zarm.Cuboid("part", size=(0.05, 0.05, 0.1), position=(0.55, 0.25, 0.1)))

    over = zarm.PoseGoal(
        zarm.Pose((0.55, 0.25, 0.18), DOWN),
        free=["theta_z"],
        tolerance={"x": 0.005, "y": 0.005},
        approach=zarm.Offset(0.15, (0, 0, 1)),
    )
    there = zarm.PoseGoal(zarm.Pose((0.5, -0.35, 0.2), DOWN), free=["theta_z"], approach=zarm.Offset(0.1, (0, 0, 1)))
    plan = robot.plan_program(
        [
            zarm.Move(over, name="pick"),
            zarm.Attach("part", touch_links=["link_6"]),
            zarm.Move(zarm.Line((0.55, 0.25, 0.4)), name="lift"),
            zarm.Move(there, name="carry"),
            zarm.Detach("part"),
            zarm.Move(zarm.Line((0.5, -0.35, 0.35)), name="leave"),
        ]
    )
    print(f"planned in {plan.timings.total * 1e3:.0f} ms, {plan.clearance * 1e3:.1f} mm clear")
    print(robot.execute(plan).status)
    part = robot.scene.objects()["part"]
    print("the part stands at", *(f"{x:.2f}" for x in part.position), "m")
    robot.scene.clear()
