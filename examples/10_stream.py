"""Closed loop: the first joint follows a target that moves, by 20 short trajectories a second.

Each trajectory is where the target will be for 0.3 s, and then a way to rest: the robot has one whatever becomes of this program.
"""

import time

import numpy as np

import zarm

HOME = (0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0)
JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
AHEAD, BRAKING, STEP = 0.3, 0.8, 0.02  # s


def target(t: np.ndarray) -> np.ndarray:
    """Position (rad), velocity and acceleration of the target at times t (s), one a column; yours comes from a sensor."""
    w, a = 2 * np.pi / 4, 0.15
    return np.stack([a * (1 - np.cos(w * t)), a * w * np.sin(w * t), a * w * w * np.cos(w * t)])


def chunk(t: float, home: np.ndarray) -> zarm.Trajectory:
    """The target from t (s) on, and then to rest: the velocity falls as (v + b s) (1 - s)^2, s from 0 to 1."""
    follow = target(t + np.arange(0.0, AHEAD + STEP / 2, STEP))
    (q, v, a), s = follow[:, -1], np.arange(STEP, BRAKING + STEP / 2, STEP) / BRAKING
    b = a * BRAKING + 2 * v
    brake = np.stack(
        [
            q + BRAKING * (v * (1 - (1 - s) ** 3) / 3 + b * (s**2 / 2 - 2 * s**3 / 3 + s**4 / 4)),
            (v + b * s) * (1 - s) ** 2,
            (b * (1 - s) ** 2 - 2 * (v + b * s) * (1 - s)) / BRAKING,
        ]
    )
    rows = np.zeros((3, follow.shape[1] + len(s), len(home)))
    rows[:, :, 0] = np.concatenate([follow, brake], axis=1)
    rows[0] += home
    return zarm.Trajectory(JOINTS, np.arange(rows.shape[1]) * STEP, *rows)


with zarm.connect() as robot:
    robot.execute(robot.plan(HOME))
    home = np.array(robot.joint_state().position)

    furthest = 0.0
    with robot.stream(deadline=1.0) as stream:
        while stream.time < 4.0:
            stream.send(chunk(stream.time, home))
            time.sleep(0.05)
            furthest = max(furthest, robot.joint_state().position[0] - home[0])
        stream.send(chunk(stream.time, home), last=True)
    print(f"followed the target for 4 s, at most {furthest:.2f} rad from home, and rests")
