"""To which scene a motion belongs, and what the state machine makes of another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn

import pytest

from support.arrivals import arrival
from support.executor.bench import Bench
from support.trajectories import HOME, ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import SceneEdited
from zarm_executor.goal import Chunk
from zarm_executor.scene import PresentScene
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

NEXT = "2-0123456789ab"
SAME_NUMBER = "1-0123456789ab"
OLDER = "0-0123456789ab"
CHUNK = TimedTrajectory.of(rest_to_rest(moved(0.5)), ROBOT.descriptor.joints)


def unanswered() -> NoReturn:
    raise Unavailable("no planner")


def answering(revision: str) -> Callable[[], SceneEdited]:
    return lambda: edited(revision)


def edited(revision: str) -> SceneEdited:
    return SceneEdited(revision=revision, count=0)


@pytest.mark.parametrize("other", [NEXT, SAME_NUMBER, OLDER])
@pytest.mark.parametrize("answers", [True, False])
def test_what_was_verified_in_any_but_the_present_scene_is_stale(other: str, answers: bool) -> None:
    present = PresentScene(Bench().machine, answering(SCENE) if answers else unanswered)
    present.receive("", edited(SCENE))
    assert present.demand("p-1", SCENE) == SCENE
    with pytest.raises(ExecutionRefused, match=f"p-1 was verified in revision {other} .* at {SCENE} now") as refusal:
        present.demand("p-1", other)
    assert refusal.value.code == "stale_plan"


def test_what_claims_no_scene_holds_in_any() -> None:
    assert PresentScene(Bench().machine, answering(SCENE)).demand("the trajectory", None) == SCENE
    assert PresentScene(Bench().machine, unanswered).demand("the trajectory", None) is None


def test_a_claim_that_nobody_can_look_at_is_refused() -> None:
    with pytest.raises(Unavailable, match="start the planner"):
        PresentScene(Bench().machine, unanswered).demand("p-1", SCENE)


def test_what_the_planner_answers_goes_before_what_it_published() -> None:
    bench = Bench()
    present = PresentScene(bench.machine, answering(NEXT))
    present.receive("", edited(SCENE))
    assert present.look() == NEXT
    assert bench.machine.scene == NEXT


def test_a_publication_during_the_answer_is_not_undone() -> None:
    bench = Bench()

    def answer() -> SceneEdited:
        present.receive("", edited(NEXT))
        return edited(SCENE)

    present = PresentScene(bench.machine, answer)
    assert present.look() == SCENE
    assert bench.machine.scene == NEXT


def test_a_goal_that_is_held_goes_on_in_its_own_scene_alone() -> None:
    bench = Bench()
    bench.execute(scene=SCENE)
    bench.run(0.3)
    bench.machine.pause(arrival())
    bench.until("paused")
    for other in (NEXT, SAME_NUMBER, None):
        with pytest.raises(ExecutionRefused, match="plan again from where the robot is") as refusal:
            bench.machine.resume(arrival(), other)
        assert refusal.value.code == "stale_plan"
    held = bench.arm.exact.position
    bench.run(0.5)
    assert bench.machine.state().mode == "paused"
    assert (bench.arm.exact.position == held).all()
    bench.machine.resume(arrival(), SCENE)
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_resuming_what_is_not_held_is_no_error() -> None:
    bench = Bench()
    bench.machine.resume(arrival(), NEXT)
    bench.execute(scene=SCENE)
    bench.machine.resume(arrival(), NEXT)
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_the_state_says_when_the_scene_is_not_the_goal_s() -> None:
    bench = Bench()
    bench.machine.scene = SCENE
    assert not bench.machine.state().scene_changed
    bench.execute(scene=SCENE)
    bench.run(0.1)
    assert not bench.machine.state().scene_changed
    bench.machine.scene = NEXT
    assert bench.machine.state().scene_changed
    bench.until("idle")
    assert not bench.machine.state().scene_changed


def test_a_stream_is_of_the_scene_in_which_its_newest_chunk_came() -> None:
    bench = Bench()
    bench.machine.scene = SCENE
    bench.stream(CHUNK, scene=SCENE)
    bench.run(0.05)
    bench.machine.scene = NEXT
    assert bench.machine.state().scene_changed
    bench.machine.pause(arrival())
    bench.until("paused")
    with pytest.raises(ExecutionRefused):
        bench.machine.resume(arrival(), NEXT)
    chunk = Chunk(2, 0.0, CHUNK, bench.now, 0.1, False)
    bench.machine.steer("stream-1", replace(chunk, scene=NEXT), Limits.of(ROBOT))
    assert not bench.machine.state().scene_changed
    bench.machine.resume(arrival(), NEXT)
    bench.run(0.05)
    assert bench.machine.state().mode == "running"
    assert (bench.arm.exact.position != HOME).any()
