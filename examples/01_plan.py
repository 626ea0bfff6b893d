"""Plan a motion of the tool to a pose, and carry it out."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)  # rad, one for each joint
DOWN = (0.0, 1.0, 0.0, 0.0)  # the tool points down: a quaternion (x, y, z, w)

with zarm.connect() as robot:
    robot.execute(robot.plan(HOME))

    plan = robot.plan(zarm.Pose((0.5, 0.3, 0.4), DOWN))
    print(f"planned {plan.trajectory.duration:.2f} s of motion in {plan.timings.total * 1e3:.0f} ms")
    print(f"it keeps {plan.clearance * 1e3:.0f} mm from everything")

    last = robot.execute(plan, on_progress=lambda goal: print(f"{goal.status} {goal.progress:4.0%}"))
    print(f"{last.status}: the tool is at", *(f"{x:.3f}" for x in robot.tip().position), "m")
