"""Put a table and a post into the scene, and plan around them."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
BEHIND_THE_POST = zarm.Pose((0.0, 0.55, 0.6), (-0.6, 0.8, 0.0, 0.0))

with zarm.connect() as robot:
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    straight = robot.plan(BEHIND_THE_POST)

    robot.scene.add(
        zarm.Cuboid("table", size=(0.6, 0.6, 0.04), position=(0.4, 0.45, 0.28)),
        zarm.Cylinder("post", radius=0.04, length=0.6, position=(0.38, 0.42, 0.6)),
    )
    print("in the scene:", ", ".join(robot.scene.objects()))

    worst = min(robot.check(straight.trajectory.position), key=lambda result: result.clearance)
    print(f"the motion that was free before: {' and '.join(worst.pair or ())} at {worst.clearance * 1e3:.0f} mm")
    try:
        robot.execute(straight)
    except zarm.ExecutionRefused as refusal:
        print(f"so it is refused: {refusal.code}")

    around = robot.plan(BEHIND_THE_POST)
    print(f"the one around them keeps {around.clearance * 1e3:.0f} mm from everything")
    print(robot.execute(around).status)
    robot.scene.clear()
