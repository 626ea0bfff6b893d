"""Two arms carry a tray: `zarm robot compose examples/two_pandas.yaml`, `zarm up --robot pandas/pandas.yaml`."""

import zarm

DOWN = (1.0, 0.0, 0.0, 0.0)
LENGTH = 0.4  # of the tray, which each arm takes at an end (m)
HANDS = {side: [f"{side}_panda_{link}" for link in ("leftfinger", "rightfinger", "hand")] for side in ("left", "right")}
TOGETHER = zarm.PathConstraint(group="right", relative_to="left", position_tolerance=0.002)


def at_ends(x: float, y: float, z: float) -> dict[str, zarm.Pose]:
    """Both tips at the ends of a tray with its middle here."""
    return {"left": zarm.Pose((x, y + LENGTH / 2, z), DOWN), "right": zarm.Pose((x, y - LENGTH / 2, z), DOWN)}


with zarm.connect() as robot:
    for name in robot.scene.attached():
        robot.scene.detach(name)
    robot.scene.clear()
    for side in HANDS:
        robot.gripper.open(f"{side}_hand")
    robot.execute(robot.plan(at_ends(0.45, 0.0, 0.3)))
    robot.scene.add(zarm.Cuboid("tray", size=(0.02, LENGTH + 0.02, 0.02), position=(0.45, 0.0, 0.3)))
    robot.scene.attach("tray", touch_links=[*HANDS["left"], *HANDS["right"]], link="left_panda_hand")
    for side in HANDS:
        robot.gripper.move(0.02, gripper=f"{side}_hand")
    for x, y, z in ((0.55, -0.1, 0.5), (0.4, 0.1, 0.2)):
        goal = zarm.Pose((x, y + LENGTH / 2, z), DOWN)
        plan = robot.plan(goal, group="left", path_constraint=TOGETHER)  # the right arm follows
        robot.execute(plan)
        apart = robot.tip("left").position[1] - robot.tip("right").position[1]
        print(f"the hands are {apart:.3f} m apart, after {plan.trajectory.time[-1]:.1f} s")
