"""Replanning in motion: planner, executor and servo as processes, and things put in the way of a moving robot at random.

    python tests/benchmarks/replanning.py [--count 1000] [--seed 0]

Every goal starts in a random scene. While the robot moves, a ball is put where one of its links is going to be and nothing of it is yet. Printed are the
contacts, by a dense check with python-fcl of what was commanded and of what was measured since the edit's answer, the share that arrived
without stopping, how long it took from that answer to a new trajectory in force and to its takeover, and how far the limits are used around
the takeover. A contact that is unavoidable is counted by itself: the robot would have it too if it braked along its trajectory as hard as
the acceleration limits allow, from REACTION after the answer on.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.executor.client import Client
from support.harness import ServiceProcess, router
from support.planner.client import load, plan, to_joints
from support.planner.second_opinion import Collisions, link_pose
from support.trajectories import KEYS, ROBOT, with_execution
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    GoalTrajectory,
    Plan,
    PlanRequest,
    SceneEdit,
    SceneObject,
    Sphere,
)
from zarm_runtime.bus import Bus
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints
LIMITS = Limits.of(ROBOT)
LINKS = tuple(ROBOT.descriptor.collision)[-4:]
STEP = 0.002
"""What was commanded is checked this often (s), and what was measured so often between two states."""
REACTION = 0.03
"""A guarded robot begins to brake within so long (s) of an edit's answer."""
RESTS, NEAR = 0.01, 0.02
"""A robot has stopped where its joints are slower (rad/s) than that, farther (rad) than this from the end."""
SEAM = 0.1
"""The limits are looked at so far (s) around a takeover."""


@dataclass
class Tally:
    """What came of the insertions; times in s, `uses` are rows of shares of the velocity, acceleration and jerk limits."""

    ends: list[str] = field(default_factory=list)
    stopped: int = 0
    on_the_way: int = 0
    contacts: list[str] = field(default_factory=list)
    unavoidable: int = 0
    told_unavoidable: int = 0
    force: list[float] = field(default_factory=list)
    takeover: list[float] = field(default_factory=list)
    uses: list[tuple[float, float, float]] = field(default_factory=list)


class Insertions:
    """Runs goals and puts things in their way."""

    def __init__(self, bus: Bus, seed: int) -> None:
        self.bus, self.client = bus, Client(bus)
        self.random = np.random.default_rng(seed)
        self.tally = Tally()
        self.reported: list[tuple[float, GoalTrajectory]] = []
        bus.subscribe(KEYS.goal_trajectory, lambda _, said: self.reported.append((time.time(), said)))

    def scene(self) -> list[SceneObject]:
        """Small boxes around the robot."""
        return [
            Cuboid(
                kind="cuboid",
                name=f"box{index}",
                position=tuple((self.random.uniform(0.5, 1.1) * direction).tolist()),
                size=(0.08, 0.08, 0.08),
            )
            for index in range(6)
            for direction in [self.direction()]
        ]

    def direction(self) -> np.ndarray:
        """A unit vector of the upper half."""
        found = self.random.normal(size=3)
        found[2] = abs(found[2])
        return found / np.linalg.norm(found)

    def way(self) -> Plan | None:
        """A plan to joints at random, where there is one that takes long enough."""
        wide = self.random.uniform(-1.5, 1.5, len(JOINTS)) * 0.8
        home = np.array(ROBOT.descriptor.home)
        with suppress(ZarmError):
            made = plan(self.bus, PlanRequest(goal=to_joints(*(home + wide).tolist()), velocity_scale=0.6))
            return made if made.trajectory.time[-1] > 2.0 else None
        return None

    def insert(self) -> bool:
        """One goal with something put in its way; whether there was one."""
        boxes = self.scene()
        try:
            load(self.bus, *boxes)
        except ZarmError:
            return False
        made = self.way()
        if made is None:
            return False
        path = TimedTrajectory.of(made.trajectory, JOINTS)
        self.reported.clear()
        self.client.measured.clear()
        self.client.goals.clear()
        try:
            goal = self.client.execute(plan_id=made.plan_id, replan=True)
        except ZarmError:
            return False
        self.client.under_way(goal, self.random.uniform(0.05, 0.4))
        ball = self.ball(path)
        add = SceneEdit(edit=AddObjects(op="add", objects=(ball,)))
        self.bus.call(KEYS.scene_edit, add, timeout=20)
        answered = time.time()
        last = self.client.ended(goal)
        return self.judge(last.status, goal, boxes, ball, answered)

    def ball(self, path: TimedTrajectory) -> Sphere:
        """A ball where a link is going to be, 0.5 to 1.5 s ahead, and nothing of the robot is now."""
        while True:
            position = np.array(self.client.measured[-1].position)
            ahead = path.nearest(position, 0.0, path.duration) + self.random.uniform(0.5, 1.5)
            link = link_pose(ROBOT, str(self.random.choice(LINKS)), path.at(min(ahead, path.duration))[0])
            place = link[:3, 3] + self.random.normal(0, 0.02, 3)
            radius = float(self.random.uniform(0.02, 0.08))
            ball = Sphere(kind="sphere", name="ball", position=tuple(place.tolist()), radius=radius)
            if not Collisions(ROBOT, [ball]).at(position):
                return ball

    def judge(self, status: str, goal: str, boxes: list[SceneObject], ball: Sphere, answered: float) -> bool:
        """Add one insertion to the tally; whether it came before the goal's end."""
        tally = self.tally
        holds = [state.hold for state in self.client.goals if state.goal_id == goal and state.hold is not None]
        followed = [(moment, said) for moment, said in list(self.reported) if said.goal_id == goal]
        trajectories = [TimedTrajectory.of(said.trajectory, JOINTS).begun_at(said.start) for _, said in followed]
        states = [state for state in self.client.measured if state.stamp >= answered]
        if not states:
            return False
        measured = np.array([state.position for state in states])
        at = trajectories[0].nearest(measured[0], 0.0, trajectories[0].duration)
        seams = [seam_of(old, new) for old, new in itertools.pairwise(trajectories)]
        tally.ends.append(status)
        end = np.array(trajectories[-1].end)
        stopped = any(
            np.abs(state.velocity).max() < RESTS and np.abs(position - end).max() > NEAR
            for state, position in zip(states, measured, strict=True)
        )
        tally.stopped += stopped
        tally.told_unavoidable += any(hold.obstruction is not None and not hold.obstruction.avoidable for hold in holds)
        touches_ball = Collisions(ROBOT, [ball])
        if any(
            map(touches_ball.at, trajectories[0].positions(np.arange(at, rest(trajectories[0], at + REACTION), STEP)))
        ):
            tally.unavoidable += 1
        else:
            tally.on_the_way += not stopped
            check = Collisions(ROBOT, [*boxes, ball])
            commanded = driven(trajectories, seams, at, measured[-1])
            for what, joints in (("measured", between(measured)), ("commanded", commanded)):
                first = next((k for k, position in enumerate(joints) if check.at(position)), None)
                if first is not None:
                    tally.contacts.append(
                        f"insertion {len(tally.ends)}, {what} {first} of {len(joints)}, with the ball: {touches_ball.at(joints[first])}, "
                        f"with itself: {Collisions(ROBOT, []).at(joints[first])}, at {at:.3f} s, seams {np.round(seams, 3).tolist()}, "
                        f"told {[round(moment - answered, 3) for moment, _ in followed[1:]]} s after the answer, "
                        f"held at {[hold.obstruction.time for hold in holds if hold.obstruction][:1]}, {status}"
                    )
                    break
        if not holds:
            for (moment, _), old, new, seam in zip(followed[1:], trajectories, trajectories[1:], seams, strict=False):
                self.seam(old, new, seam, moment, answered)
        return True

    def seam(self, old: TimedTrajectory, new: TimedTrajectory, at: float, moment: float, answered: float) -> None:
        """Note when `new`, which was reported at `moment`, took over at the path time `at` (s), and how hard."""
        where = np.array([state.position for state in self.client.measured])
        nearest = int(np.abs(where - new.at(at)[0]).max(axis=1).argmin())
        self.tally.force.append(moment - answered)
        self.tally.takeover.append(self.client.measured[nearest].stamp - answered)
        around = np.arange(max(at - SEAM, new.begin), min(at + SEAM, new.duration), 0.001)
        _, velocity, acceleration = new.sample(around)
        near = np.flatnonzero((new.time[1:] > at - SEAM) & (new.time[:-1] < at + SEAM))
        jerk = np.abs(np.diff(new.acceleration, axis=0)[near]) / new.steps[near, None]
        self.tally.uses.append(
            (
                float((np.abs(velocity) / LIMITS.velocity).max()),
                float((np.abs(acceleration) / LIMITS.acceleration).max()),
                float((jerk / LIMITS.jerk).max()),
            )
        )


def seam_of(old: TimedTrajectory, new: TimedTrajectory) -> float:
    """The path time (s) at which `new` leaves `old`."""
    times = np.arange(max(old.begin, new.begin), min(old.duration, new.duration), 0.001)
    apart = np.abs(new.positions(times) - old.positions(times)).max(axis=1) > 1e-7
    return float(times[apart.argmax()]) if apart.any() else float(times[-1])


def rest(path: TimedTrajectory, time: float) -> float:
    """The path time (s) at which a robot rests that brakes along `path` from `time` (s) on, with full acceleration.

    With the path time's rate v the joints accelerate by q'' v^2 + q' dv/dt.
    """
    rate, step = 1.0, 0.001
    while rate > 0.0 and time < path.duration:
        _, slope, bend = path.at(time)
        moving = np.abs(slope) > 1e-6
        hardest = -(LIMITS.acceleration + np.sign(slope) * bend * rate**2)[moving] / np.abs(slope[moving])
        rate += step * min(float(hardest.max(initial=-np.inf)), 0.0)
        time += step * max(rate, 0.0)
    return min(time, path.duration)


def driven(trajectories: list[TimedTrajectory], seams: list[float], start: float, last: np.ndarray) -> np.ndarray:
    """The joints (N, J) that were commanded, from the path time `start` (s) of the first trajectory to where the robot was `last` (J,)."""
    newest = trajectories[-1]
    ends = [*seams, newest.nearest(last, seams[-1] if seams else start, newest.duration)]
    spans = [(path, begin, end) for path, begin, end in zip(trajectories, [start, *seams], ends, strict=True)]
    return np.concatenate([path.positions(np.append(np.arange(begin, end, STEP), end)) for path, begin, end in spans])


def between(measured: np.ndarray) -> np.ndarray:
    """Measured joints (N, J), and joints on the straight lines between them."""
    shares = np.arange(0.0, 1.0, STEP / ROBOT.descriptor.execution.control_period)
    lines = [before + shares[:, None] * (after - before) for before, after in itertools.pairwise(measured)]
    return np.concatenate([*lines, measured[-1:]])


def percentiles(what: str, seconds: list[float]) -> str:
    """Median, p95 and the longest, in ms."""
    if not seconds:
        return f"{what}: never"
    median, late, longest = np.percentile(np.array(seconds) * 1e3, (50, 95, 100))
    return f"{what}: median {median:.0f} ms, p95 {late:.0f} ms, longest {longest:.0f} ms ({len(seconds)})"


def main() -> None:
    """Print the tally."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        robot = str(with_execution(folder / "robot", "guard_timeout: 2.0, obstruction_timeout: 2.0"))
        for service in ("planner", "servo", "executor"):
            process = stack.enter_context(ServiceProcess(service, endpoint, folder, robot))
            process.wait_ready(bus, KEYS)
        runs = Insertions(bus, options.seed)
        done = 0
        while done < options.count:
            done += runs.insert()
    tally = runs.tally
    arrived = tally.ends.count("succeeded")
    lines = (
        f"{done} insertions: {len(tally.contacts)} contacts in {done - tally.unavoidable} that braking avoids "
        f"({tally.told_unavoidable} of all were told to be unavoidable)",
        f"arrived {arrived} ({100 * arrived / done:.0f} %), without stopping {100 * (done - tally.stopped) / done:.0f} %, where braking avoids "
        f"contact {100 * tally.on_the_way / max(done - tally.unavoidable, 1):.0f} %; replaced in motion {len(tally.uses)} times",
        percentiles("from the edit's answer to a new trajectory in force", tally.force),
        percentiles("from the edit's answer to its takeover", tally.takeover),
    )
    sys.stdout.write("\n".join(lines) + "\n")
    for contact in tally.contacts:
        sys.stdout.write(f"contact: {contact}\n")
    if tally.uses:
        velocity, acceleration, jerk = np.max(tally.uses, axis=0)
        sys.stdout.write(
            f"greatest share of the limits around a takeover: velocity {velocity:.3f}, acceleration {acceleration:.3f}, jerk {jerk:.3f}\n"
        )


if __name__ == "__main__":
    main()
