"""What a session streams is followed exactly as it was checked."""

from __future__ import annotations

import numpy as np
import pytest

from support.trajectories import ROBOT
from zarm_executor.checks import continuation
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.controller import Controller
from zarm_servo.tracking.session import CHUNK, soft
from zarm_servo.tracking.streamed_trajectory import REST, StreamedTrajectory
from zarm_servo.tracking.targets import Target, TwistTarget
from zarm_trajectory.blending import blended
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

MODEL = RobotModel.of(ROBOT)
LIMITS = Limits.of(ROBOT)
HOME = np.array(ROBOT.descriptor.home)


def test_chunks_join_exactly_within_limits_and_end_at_rest() -> None:
    controller = Controller(MODEL, MotionCheck(MODEL), soft(LIMITS), HOME, margin=0.01)
    streamed, followed = StreamedTrajectory(0.0, controller.state, controller.braking), TimedTrajectory.standing(HOME)
    states = [controller.state]
    rng = np.random.default_rng(5)
    target: Target = TwistTarget(np.zeros(6))
    for cycle in range(40 * CHUNK):
        if cycle % 50 == 0:
            target = TwistTarget(np.append(rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.5, 0.5, 3)))
        streamed.add(step := controller.step(target, 0.0))
        states.append(step.state)
        if streamed.pending == CHUNK:
            start, chunk = streamed.chunk()
            continuation(chunk.message(ROBOT.descriptor.joints), ROBOT, np.zeros(MODEL.dof))
            followed = blended(followed, max(start - 0.03, 0.0), chunk, start, LIMITS)
            assert np.all(chunk.states[1:, -1] == 0.0)
    LIMITS.check(followed)
    kept = np.flatnonzero(PERIOD * np.arange(len(states)) >= followed.time[0])
    np.testing.assert_allclose(
        followed.sample(PERIOD * kept), np.swapaxes([states[index] for index in kept], 0, 1), atol=1e-6
    )
    assert followed.duration >= streamed.time + REST


@pytest.mark.lengthy
@pytest.mark.parametrize("seed", [5, 15, 66])
def test_a_late_chunk_is_followed_within_limits(seed: int) -> None:
    controller = Controller(MODEL, MotionCheck(MODEL), soft(LIMITS), HOME, margin=0.01)
    streamed, followed = StreamedTrajectory(0.0, controller.state, controller.braking), TimedTrajectory.standing(HOME)
    rng = np.random.default_rng(seed)
    target: Target = TwistTarget(np.zeros(6))
    for cycle in range(60 * CHUNK):
        if cycle % 30 == 0:
            target = TwistTarget(np.append(rng.uniform(-0.5, 0.5, 3), rng.uniform(-1.0, 1.0, 3)))
        streamed.add(controller.step(target, 0.0))
        if streamed.pending == CHUNK:
            start, chunk = streamed.chunk()
            for now in start + np.array((0.001, 0.004, 0.01, 0.03)):  # the robot brakes already
                reached = blended(followed, now, chunk, start, LIMITS)
                LIMITS.check(reached)
                np.testing.assert_allclose(reached.at(now), followed.at(now), atol=1e-6)
                np.testing.assert_allclose(reached.end, chunk.end, atol=1e-9)
            followed = blended(followed, max(start - 0.03, 0.0), chunk, start, LIMITS)
