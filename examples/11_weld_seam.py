"""Weld a seam around a post: the torch keeps its tilt and its speed, and may turn freely about its own axis."""

import math

import zarm

CENTER, RADIUS, HEIGHT = (0.55, 0.0), 0.06, 0.35
TILT = math.radians(25)


def torch(angle: float) -> zarm.Pose:
    """The torch at an angle around the post: it points down and, by TILT, towards the post."""
    half = TILT / 2
    lean = (0.0, math.sin(half), 0.0, math.cos(half))  # leaning about y, then turned about the post's axis
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    x, y, z, w = lean
    turned = (c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z)
    down = (turned[3], turned[2], -turned[1], -turned[0])  # half a turn about x: the tool's z points down
    position = (CENTER[0] + RADIUS * math.cos(angle), CENTER[1] + RADIUS * math.sin(angle), HEIGHT)
    return zarm.Pose(position, down)


with zarm.connect() as robot:
    robot.scene.clear()
    robot.scene.add(zarm.Cylinder("post", radius=0.045, length=0.3, position=(*CENTER, 0.15)))

    seam = [torch(math.pi + math.radians(3 * k)) for k in range(61)]  # the far half of the post
    program = [
        zarm.Move(zarm.PoseGoal(seam[0], free=["theta_z"], approach=zarm.Offset(0.08, (0, 0, 1))), name="begin"),
        zarm.Move(zarm.Path(*seam[1:], speed=0.02, free=["theta_z"]), name="seam"),
        zarm.Move(zarm.Line((*seam[-1].position[:2], HEIGHT + 0.1)), name="away"),
    ]
    plan = robot.plan_program(program)
    for segment in plan.segments:
        print(f"{segment.name}: {segment.begin:.2f} to {segment.end:.2f} s")
    print(robot.execute(plan).status)
    robot.scene.clear()
