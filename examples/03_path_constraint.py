"""Carry a full glass: the tool keeps its orientation all the way."""

import math

import zarm

SLANTED = (0.0, 0.924, 0.0, 0.383)  # the tool points forwards and down: a quaternion (x, y, z, w)


def turned(a: zarm.Pose, b: zarm.Pose) -> float:
    """The angle (rad) between two orientations."""
    cosine = abs(sum(x * y for x, y in zip(a.orientation, b.orientation, strict=True)))
    return 2 * math.acos(min(1.0, cosine))


with zarm.connect() as robot:
    robot.execute(robot.plan(zarm.Pose((0.4, -0.4, 0.5), SLANTED)))
    start = robot.tip()
    goal = zarm.Pose((0.4, 0.4, 0.5), SLANTED)

    level = zarm.PathConstraint(("theta_x", "theta_y", "theta_z"))
    for name, plan in (("free", robot.plan(goal)), ("constrained", robot.plan(goal, path_constraint=level))):
        on_the_way = robot.fk(plan.trajectory.position[::5])
        tilt = max(turned(start, tip) for tip in on_the_way)
        print(f"{name}: {plan.trajectory.duration:.2f} s, tilts by up to {math.degrees(tilt):.2f} degrees")

    print(robot.execute(plan).status)
