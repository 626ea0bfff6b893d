"""What the page shows of a simulation: what the scene has not, where it really is, and what presses on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
import viser

import zarm
from support.viewer import free_port
from zarm_contract.messages import BodyPose, Contact, PhysicsObjects, PhysicsState
from zarm_viewer.simulation_view import FORCE_LENGTH, LONGEST, SimulationView, forces

TABLE = zarm.Cuboid("table", size=(1.0, 1.0, 0.1), position=(0.5, 0.0, -0.05))
POST = zarm.Cuboid("post", size=(0.1, 0.1, 0.5), position=(0.5, 0.3, 0.25))
BALL = zarm.Sphere("ball", radius=0.05, position=(0.5, 0.0, 0.5))


@dataclass
class Panels:
    """What the view needs of the panels."""

    server: viser.ViserServer
    root: str = "/robots/arm"


@pytest.fixture
def drawn() -> Iterator[tuple[SimulationView, dict[str, Any]]]:
    """The view, and what is drawn by its name."""
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    view = SimulationView(cast(Any, Panels(server)), ())
    yield view, server.scene._handle_from_node_name
    server.stop()


def state(*contacts: Contact, at: tuple[float, float, float] = (0.5, 0.0, 0.05)) -> PhysicsState:
    ball = BodyPose(name="ball", position=at, orientation=(0.0, 0.0, 1.0, 0.0))
    return PhysicsState(
        stamp=1.0,
        time=1.0,
        real_time_factor=1.0,
        position=(0.0,),
        velocity=(0.0,),
        effort=(0.0,),
        bodies=(ball,),
        contacts=contacts,
    )


def names(nodes: dict[str, Any]) -> set[str]:
    return {node.rpartition("/")[2] for node in nodes if "/simulation/" in node}


def test_objects_that_the_scene_has_too_are_drawn_once(drawn: tuple[SimulationView, dict[str, Any]]) -> None:
    view, nodes = drawn
    view.draw_objects(PhysicsObjects(objects=(TABLE, POST)))
    assert names(nodes) == {"table", "post"}
    view.believe((TABLE,))
    assert names(nodes) == {"post"}
    view.believe(())
    assert names(nodes) == {"table", "post"}
    view.draw_objects(PhysicsObjects())
    assert names(nodes) == set()


def test_what_moves_is_where_it_really_is(drawn: tuple[SimulationView, dict[str, Any]]) -> None:
    view, nodes = drawn
    view.draw_objects(PhysicsObjects(objects=(TABLE, BALL)))
    view.believe((TABLE, BALL))
    view.draw_state(state())
    (ball,) = (handle for node, handle in nodes.items() if node.endswith("/simulation/ball"))
    assert ball.position == pytest.approx((0.5, 0.0, 0.05))
    assert ball.wxyz == pytest.approx((0.0, 0.0, 0.0, 1.0))


def test_forces_are_lines_along_the_normal(drawn: tuple[SimulationView, dict[str, Any]]) -> None:
    view, nodes = drawn
    weak, strong = (
        Contact(first="floor", second="ball", position=(0.5, 0.0, 0.0), force=force, normal=(0.0, 0.0, 1.0))
        for force in (5.0, 1e6)
    )
    (line,) = forces((weak,))
    assert line == pytest.approx(np.array([(0.5, 0.0, -5.0 * FORCE_LENGTH), (0.5, 0.0, 5.0 * FORCE_LENGTH)]))
    assert forces((strong,))[0, 1, 2] == pytest.approx(LONGEST)
    view.draw_state(state(weak))
    assert any(node.endswith("/forces") for node in nodes)
    view.draw_state(state())
    assert not any(node.endswith("/forces") for node in nodes)
