"""Ten boxes from a table into a tray, with a gripper: `zarm up --robot panda`."""

import zarm

DOWN = (1.0, 0.0, 0.0, 0.0)
SIDE, HEIGHT = 0.04, 0.05
BOXES = {f"box_{i}": (0.40 + 0.09 * (i // 5), -0.35 + 0.09 * (i % 5)) for i in range(10)}
PLACES = {f"box_{i}": (0.42 + 0.08 * (i // 5), 0.20 + 0.08 * (i % 5)) for i in range(10)}

with zarm.connect() as robot:
    robot.scene.clear()
    robot.scene.add(zarm.Cuboid("table", size=(0.6, 1.3, 0.1), position=(0.5, 0.0, -0.055)))
    robot.scene.add(zarm.Cuboid("tray", size=(0.3, 0.45, 0.01), position=(0.46, 0.36, 0.0)))
    for name, (x, y) in BOXES.items():
        robot.scene.add(zarm.Cuboid(name, size=(SIDE, SIDE, HEIGHT), position=(x, y, HEIGHT / 2 - 0.004)))

    for name, (x, y) in BOXES.items():
        grasp = zarm.PoseGoal(zarm.Pose((x, y, 0.03), DOWN), tolerance={"theta_z": 0.05})
        robot.pick(name, grasp, width=SIDE)  # the fingers of an emulated gripper are stopped by nothing
        robot.place(zarm.Pose((*PLACES[name], 0.042), DOWN), open_to=SIDE + 0.015, upright=True)
        x, y, _ = robot.scene.objects()[name].position
        print(f"{name} stands at {x:.3f} {y:.3f}")
    robot.scene.clear()
