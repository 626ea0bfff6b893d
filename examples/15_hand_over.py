"""One arm hands a bar over to the other: `zarm robot compose examples/two_pandas.yaml`, `zarm up --robot pandas/pandas.yaml`."""

import zarm

DOWN = (1.0, 0.0, 0.0, 0.0)
GRASPS, HEIGHT = 0.11, 0.4  # how far from the middle of the bar each arm takes it, and where they meet (m)
HANDS = {side: [f"{side}_panda_{link}" for link in ("leftfinger", "rightfinger", "hand")] for side in ("left", "right")}
DOWN_TO_THE_BAR = zarm.Offset(0.1, (0, 0, 1), touch=("bar",))


def above(x: float, y: float, z: float) -> zarm.PoseGoal:
    """A pose of the tip on the bar, reached straight from above."""
    return zarm.PoseGoal(zarm.Pose((x, y, z), DOWN), approach=DOWN_TO_THE_BAR)


with zarm.connect() as robot:
    for name in robot.scene.attached():
        robot.scene.detach(name)
    robot.scene.clear()
    robot.scene.add(zarm.Cuboid("bar", size=(0.03, 0.3, 0.03), position=(0.5, -0.3, 0.1)))
    for side in HANDS:
        robot.gripper.open(f"{side}_hand")
    program = [
        zarm.Move(above(0.5, -0.3 - GRASPS, 0.1), group="right", touch=["bar"]),
        zarm.Grip(0.03, gripper="right_hand"),
        zarm.Attach("bar", HANDS["right"], link="right_panda_hand"),
        zarm.Move(zarm.Pose((0.5, -GRASPS, HEIGHT), DOWN), group="right"),
        zarm.Detach("bar"),
        zarm.Move(above(0.5, GRASPS, HEIGHT), group="left", touch=["bar"]),
        zarm.Grip(0.03, gripper="left_hand"),
        zarm.Attach("bar", [*HANDS["left"], *HANDS["right"]], link="left_panda_hand"),
        zarm.Grip(0.08, gripper="right_hand"),
        zarm.Move(zarm.Line(zarm.Pose((0.5, -GRASPS, HEIGHT + 0.12), DOWN)), group="right"),
        zarm.Move({"left": zarm.Pose((0.45, 0.3, 0.4), DOWN), "right": zarm.Pose((0.45, -0.35, 0.4), DOWN)}),
    ]
    robot.execute(robot.plan_program(program, timeout=30.0))
    print(f"{robot.scene.attached()['bar'].link} holds the bar")
