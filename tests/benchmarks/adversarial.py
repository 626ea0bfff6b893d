"""Whether a robot ever moves into what moves: `python tests/benchmarks/adversarial.py [--count 10000] [--seed 0] [--mode chunks] [--lag 0.1]`.

Objects come at an M1013 at up to their stated speed (up to 1 m/s), turn around, wait and dash, while it executes a goal, follows a
target or chunks of a policy, in turns or as `--mode` says; in 3 of 10 runs the servo dies at a random moment. Poses come 20 to 100 times a second, up to 30 ms late, on a clock
that is up to 18 ms off. Guard, session, controller and the executor's state machine are those of the product, in this process, with
a clock that is turned by hand and an arm that follows exactly, or with `--lag` so many seconds later; python-fcl looks every 10 ms whether there is contact.

Prints how the runs ended. `hit`: the object came upon a robot that rested or went away from it. `contact`: the robot moved towards
it by more than 2 mm/s; with any, the exit code is 1 and the seeds are printed.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console
from rich.table import Table

from support.servo.adversary import MODES, Attack, Cell


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="attacks")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first one")
    parser.add_argument("--mode", choices=MODES, help="the only thing that the robot does (default: all in turns)")
    parser.add_argument(
        "--lag",
        type=float,
        default=0.0,
        help="how much later than commanded the arm moves (s), as the servo has seen before",
    )
    options = parser.parse_args()
    logging.disable()
    cell, began = Cell(), time.process_time()
    ended: dict[str, list[Attack]] = {mode: [] for mode in MODES}
    contacts = []
    for number in range(options.count):
        mode, seed = options.mode or MODES[number % len(MODES)], options.seed + number
        attack = cell.attack(seed, mode, options.lag)
        ended[mode].append(attack)
        if attack.outcome == "contact":
            contacts.append(f"{mode} {seed}")
    console, table = (
        Console(width=120),
        Table("mode", "runs", "contact", "hit", "free", "moved", "held", "killed", "arrived"),
    )
    for mode, attacks in ended.items():
        outcomes = Counter(attack.outcome for attack in attacks)
        shown = [outcomes["contact"], outcomes["hit"], outcomes["free"]]
        shown += [sum(getattr(attack, what) for attack in attacks) for what in ("moved", "held", "killed", "arrived")]
        table.add_row(mode, str(len(attacks)), *map(str, shown))
    console.print(table)
    console.print(f"{(time.process_time() - began) / max(options.count, 1):.2f} s of CPU time a run")
    if contacts:
        console.print(f"contacts: {', '.join(contacts)}")
    return 1 if contacts else 0


if __name__ == "__main__":
    sys.exit(main())
