"""Slow a motion down while it runs, hold it, and go on."""

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)

with zarm.connect() as robot:
    robot.execute(robot.plan(HOME))

    goal = robot.start(robot.plan((1.0, *HOME[1:])))  # does not wait
    robot.speed(0.5)
    held = False
    for state in robot.goal_states(goal):
        print(f"{state.status} {state.progress:4.0%}")
        if state.status == "running" and state.progress > 0.4 and not held:
            robot.pause()
            held = True
        if state.status == "paused":
            robot.speed(1.0)
            robot.resume()
