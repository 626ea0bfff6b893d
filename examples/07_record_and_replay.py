"""Record a motion, tell what happened, and publish it once more as that of another robot."""

import tempfile
from pathlib import Path

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "motion.mcap"  # Foxglove opens it too
    with zarm.connect() as robot:
        robot.execute(robot.plan(HOME))
        with robot.record(file) as recorder:
            robot.execute(robot.plan((0.3, *HOME[1:])))
        print(f"{recorder.count} messages in {file.name}")

    story = zarm.story(file)
    for event in story.events:
        print(f"{event.time:6.3f} s  {event.subject}: {event.what}")
    if story.deviation is not None:
        print(f"{story.deviation.joint} was {story.deviation.size:.4f} rad off at most")

    count = zarm.replay(file, "echo", speed=2.0)  # `zarm watch --name echo` sees it, and nothing moves
    print(f"{count} messages published again as those of the robot echo")
