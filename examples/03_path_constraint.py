"""Carry a full glass: the tool keeps its orientation all the way."""

import math

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)


def turned(a: zarm.Pose, b: zarm.Pose) -> float:
    """The angle (rad) between two orientations."""
    cosine = abs(sum(x * y for x, y in zip(a.orientation, b.orientation, strict=True)))
    return 2 * math.acos(min(1.0, cosine))


with zarm.connect() as robot:
    robot.execute(robot.plan(HOME))
    start = robot.tip()
    x, y, z = start.position
    goal = zarm.Pose((x, y + 0.3, z - 0.1), start.orientation)

    upright = zarm.PathConstraint(("theta_x", "theta_y", "theta_z"))
    for name, plan in (("free", robot.plan(goal)), ("constrained", robot.plan(goal, path_constraint=upright))):
        on_the_way = robot.fk(plan.trajectory.position[::5])
        tilt = max(turned(start, tip) for tip in on_the_way)
        print(f"{name}: {plan.trajectory.duration:.2f} s, tilts by up to {math.degrees(tilt):.2f} degrees")

    print(robot.execute(plan).status)
