"""A policy that knows nothing, in physics: `python tests/benchmarks/random_policy.py [--episodes 100] [--seconds 1.5] [--seed 0]`.

An M1013, its mass that of its geometry, stands in a cell with a floor, a post and a shelf, and is driven by what a random policy says, in turns: single positions 30 times a second,
as LeRobot sends actions, and chunks of 16 points. Each episode walks at random from where the robot is, at up to 0.15 rad per action. *Contacts* are those that the simulation
counts of a link with anything, in any of its states; *moved* is how far the joint that moves most goes in an episode. *Ended* are sessions that the executor has ended, braking, because
a busy machine brought steps too late.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

import zarm
from support.harness import ServiceProcess, eventually, router
from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import Cuboid, PhysicsState, SceneObject
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

NAME = "doosan_m1013"
ROBOT = load_robot(NAME)
DT = 1 / 30
RESTS = 0.005
"""A robot whose joints are slower (rad/s) rests."""
CELL: tuple[SceneObject, ...] = (
    Cuboid(kind="cuboid", name="floor", position=(0.0, 0.0, -0.11), size=(3.0, 3.0, 0.2)),
    Cuboid(kind="cuboid", name="post", position=(0.45, 0.3, 0.4), size=(0.08, 0.08, 0.8)),
    Cuboid(kind="cuboid", name="shelf", position=(0.6, -0.2, 0.25), size=(0.3, 0.4, 0.03)),
)


class Watch:
    """What the simulation says about contacts of the robot."""

    def __init__(self) -> None:
        self.states = 0
        self.touched: set[tuple[str, str]] = set()

    def __call__(self, _: str, state: PhysicsState) -> None:
        self.states += 1
        links = {*ROBOT.descriptor.collision}
        for contact in state.contacts:
            pair = {contact.first, contact.second}
            if pair & links and not pair <= links:
                self.touched.add((contact.first, contact.second))


def episode(robot: zarm.Robot, rng: np.random.Generator, seconds: float, *, chunks: bool) -> tuple[float, int]:
    """How far the robot moved (rad), and how many actions were refused."""
    begun, refused = np.array(robot.joint_state().position), 0
    aim = begun.copy()
    lower, upper = np.array(ROBOT.lower), np.array(ROBOT.upper)
    size = float(rng.choice((0.01, 0.05, 0.15)))
    way = rng.normal(size=len(aim))
    until, due = time.monotonic() + seconds, time.monotonic()
    with robot.track(chunks=True) if chunks else robot.track() as tracking:
        while time.monotonic() < until:
            count = 16 if chunks else 1
            steps = size * (0.7 * way + 0.5 * rng.normal(size=(count, len(aim)))) / 2
            rows = np.clip(aim + np.cumsum(steps, axis=0), lower, upper)
            aim = rows[min(4, count - 1)] if chunks else rows[0]
            try:
                if isinstance(tracking, zarm.ChunkTracking):
                    tracking.follow(rows, dt=DT)
                else:
                    tracking.to(aim)
            except InvalidRequest:
                refused += 1
                aim = np.array(robot.joint_state().position)
            due += (5 if chunks else 1) * DT
            time.sleep(max(0.0, due - time.monotonic()))
    return float(np.abs(np.subtract(robot.joint_state().position, begun)).max()), refused


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=1.5, help="of an episode")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, watch = np.random.default_rng(options.seed), Watch()
    moved: dict[str, list[float]] = {"positions": [], "chunks": []}
    turned_down, ended = {"positions": 0, "chunks": 0}, {"positions": 0, "chunks": 0}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus, keys = stack.enter_context(Bus(endpoint)), Keys(NAME)
        for service in ("physics_sim", "planner", "executor", "servo"):
            stack.enter_context(ServiceProcess(service, endpoint, folder, robot=NAME)).wait_ready(bus, keys)
        robot = stack.enter_context(zarm.connect(endpoint, NAME))
        robot.simulation.load(world_file(folder))
        robot.strategy("joint_speed")
        bus.subscribe(keys.physics_state, watch)
        for number in range(options.episodes):
            kind = "chunks" if number % 2 else "positions"
            try:
                far, refused = episode(robot, rng, options.seconds, chunks=kind == "chunks")
            except ExecutionRefused:
                ended[kind] += 1
                eventually(lambda: max(map(abs, robot.joint_state().velocity)) < RESTS, "the robot rests")
                continue
            moved[kind].append(far)
            turned_down[kind] += refused
    table = Table("what the policy sends", "episodes", "moved, median", "refused", "ended")
    for kind, found in moved.items():
        table.add_row(
            kind, str(len(found) + ended[kind]), f"{np.median(found):.2f} rad", str(turned_down[kind]), str(ended[kind])
        )
    Console().print(table)
    Console().print(f"{watch.states} states of the simulation, contacts: {sorted(watch.touched) or 'none'}")


def world_file(folder: Path) -> Path:
    """The cell as a world."""
    file = folder / "cell.yaml"
    lines = ["objects:"] + [f"  - {item.model_dump_json()}" for item in CELL]
    file.write_text("\n".join(lines))
    return file


if __name__ == "__main__":
    main()
