"""The simulated arm plays as the Doosan bridge does, inside the limits of the controller."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_simulated_driver.player import CEILING, STEP, TICK, Player

NONE = np.zeros((0, 2))


def stepped(player: Player, seconds: float) -> np.ndarray:
    """Velocities (N, J) of the arm, step by step."""
    velocities = []
    for _ in range(round(seconds / STEP)):
        player.step()
        velocities.append(player.velocity)
    return np.array(velocities)


def constant(points: int, *velocity: float) -> np.ndarray:
    return np.tile(velocity, (points, 1))


def test_one_point_is_played_per_tick_whatever_its_position() -> None:
    player = Player(np.zeros(2))
    player.play(constant(100, 9.0, 9.0), constant(100, 0.1, -0.05))
    stepped(player, 50 * TICK)
    assert player.played == 50
    assert player.fraction == 0.5
    stepped(player, 50 * TICK)
    assert player.fraction == 1.0
    stepped(player, 1.0)
    np.testing.assert_allclose(player.position, [100 * TICK * 0.1, -100 * TICK * 0.05], atol=1e-3)


def test_it_keeps_the_controller_s_speed_and_acceleration() -> None:
    player = Player(np.zeros(2))
    player.play(constant(200, 0.0, 0.0), constant(200, 9.0, -9.0))
    velocities = stepped(player, 2.0)
    assert np.abs(velocities).max() == pytest.approx(CEILING, rel=0.01)
    assert np.abs(np.diff(velocities, axis=0)).max() <= CEILING * STEP * 1.0001


def test_where_the_points_run_out_it_brakes_to_rest() -> None:
    player = Player(np.zeros(2))
    player.play(constant(50, 0.0, 0.0), constant(50, 0.5, 0.5))
    velocities = stepped(player, 3.0)
    assert velocities[90][0] == pytest.approx(0.5, rel=0.01)
    assert not velocities[-1].any()


def test_an_empty_command_stops_it_and_a_new_one_replaces_it() -> None:
    player = Player(np.zeros(2))
    player.play(constant(500, 0.0, 0.0), constant(500, 0.5, 0.5))
    stepped(player, 1.0)
    player.play(constant(500, 0.0, 0.0), constant(500, -0.2, -0.2))
    assert stepped(player, 1.0)[-1] == pytest.approx([-0.2, -0.2], rel=0.01)
    player.play(NONE, NONE)
    assert not stepped(player, 1.0)[-1].any()
    assert player.fraction == 1.0


def test_stalled_it_brakes_and_resumes_at_its_point() -> None:
    player = Player(np.zeros(2))
    player.play(constant(100, 0.0, 0.0), constant(100, 0.2, 0.2))
    stepped(player, 0.5)
    played = player.played
    for _ in range(100):
        player.step(stalled=True)
    assert player.played == played
    assert not player.velocity.any()
    stepped(player, 0.5)
    assert player.played > played


def test_played_by_position_it_ends_at_the_last_point() -> None:
    player = Player(np.zeros(2), plays="position")
    u = np.linspace(0.0, 1.0, 100)[:, None]
    player.play(np.array([0.5, -0.3]) * (10 * u**3 - 15 * u**4 + 6 * u**5), NONE)
    stepped(player, 4.0)
    np.testing.assert_allclose(player.position, [0.5, -0.3], atol=1e-3)
    assert not player.velocity.any()


def test_an_incomplete_point_repeats_the_last_and_is_counted() -> None:
    lacking = np.array([[0.1, 0.1], [np.nan, np.nan], [0.3, np.nan], [0.4, 0.4]])
    player = Player(np.zeros(2))
    assert player.play(np.full((4, 2), np.nan), lacking) == 2
    fed = []
    for _ in range(4):
        stepped(player, TICK)
        fed.append(player.feed.tolist())
    assert fed == [[0.1, 0.1], [0.1, 0.1], [0.1, 0.1], [0.4, 0.4]]

    player = Player(np.zeros(2), plays="position")
    assert player.play(lacking, NONE) == 2
    fed = []
    for _ in range(4):
        stepped(player, TICK)
        fed.append(player.feed.tolist())
    np.testing.assert_allclose(fed, [[0.0, 0.0], [0.0, 0.0], [15.0, 15.0], [0.0, 0.0]], atol=1e-9)


def test_without_velocities_it_goes_on_as_before() -> None:
    player = Player(np.zeros(2))
    player.play(constant(500, 0.0, 0.0), constant(500, 0.2, -0.2))
    stepped(player, 1.0)
    assert player.play(constant(500, 0.0, 0.0), NONE) == 500
    stepped(player, 1.0)
    assert player.feed.tolist() == [0.2, -0.2]
