"""Topics of MoveIt Servo: twists, poses and joint speeds in, and trajectories of policies; status out."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Self

from control_msgs.msg import JointJog
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Int8, String
from trajectory_msgs.msg import JointTrajectory

from zarm.servoing import ChunkTracking, Jogging, Tracking, limited
from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Cancelled, InvalidRequest, ZarmError
from zarm_contract.messages import ServoSession
from zarm_ros_bridge.convert.servo_commands import (
    INVALID,
    NO_WARNING,
    STATUS,
    LookUp,
    Send,
    chunk_of,
    joint_speed_of,
    lasting,
    target_of,
    twist_of,
)
from zarm_ros_bridge.convert.times import NANOSECONDS
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Only the newest command counts. Reliable publishers are heard as well."""
STALE = 0.1
"""s; how long a command counts, and how much later than others of its topic it may arrive."""
SESSION_SECONDS = 1.0
"""A session ends after this long (s) without a command."""
RELEASE_SECONDS = 0.5
"""After a session that someone else has ended, or that could not begin, commands must pause for this long (s)."""
_REPORT_PERIOD = 0.1
_FORGOTTEN = 10.0
_DRIFT = 1e-3  # two clocks drift by less than this (s per s)

Read = Callable[[Any, RobotDescriptor, LookUp], Send]
Session = Tracking | ChunkTracking | Jogging
Opens = Callable[..., AbstractContextManager[Any]]


@dataclass(frozen=True)
class _Command:
    """A message on `topic` at `time` (s, monotonic), which leads the robot for the next `lasts` s."""

    topic: str
    time: float
    send: Send
    lasts: float = 0.0


class Punctuality:
    """Detects late messages of a topic by their stamps, whatever clock these come from."""

    def __init__(self) -> None:
        self._least: float | None = None  # least delay (s) from stamp to arrival
        self._received_at = 0.0

    def late(self, stamp: float, now: float) -> bool:
        """Whether a message came STALE s later than others; never for a stamp of 0, which means none."""
        if not stamp:
            return False
        offset, passed = now - stamp, now - self._received_at
        if self._least is None or passed > _FORGOTTEN:
            self._least = offset
        self._least = min(self._least + _DRIFT * passed, offset)
        self._received_at = now
        return offset - self._least > STALE


class ServoCommands:
    """Jogs and tracks by commands on four topics, in one servo session at a time. Use it in `with`.

    The first command on a topic opens a session, which belongs to that topic until it pauses.
    """

    def __init__(self, ros: Ros, other: Ros, engine: Engine, frames: Frames) -> None:
        self._engine = engine
        self._look_up = frames.found
        self._log = ros.node.get_logger()
        self._came = threading.Condition()
        self._newest: dict[str, _Command] = {}
        self.report: Callable[[int, str], None] = lambda _code, _text: None
        """Called with each status and its text."""
        self._ended = False
        self._reported: tuple[int, str] | None = None
        self._reported_at = 0.0
        self._status = ros.node.create_publisher(Int8, "~/servo_status", 10)
        self._text = ros.node.create_publisher(String, "~/servo_status/text", 10)
        client = engine.client
        self._opens: dict[str, Opens] = {}
        for listener, topic, kind, read, opens in (
            (ros, "delta_twist_cmds", TwistStamped, twist_of, client.jog),
            (ros, "delta_joint_cmds", JointJog, joint_speed_of, client.jog),
            (other, "delta_joint_cmds", JointState, joint_speed_of, client.jog),
            (ros, "pose_target_cmds", PoseStamped, target_of, client.track),
            (ros, "joint_trajectory_cmds", JointTrajectory, chunk_of, partial(client.track, chunks=True)),
        ):
            self._opens[topic] = opens
            punctuality = None if kind is JointTrajectory else Punctuality()  # a chunk says itself what it is meant for
            on_command = partial(self.take, topic, read, punctuality)
            listener.listen(kind, ros.node.resolve_topic_name(f"~/{topic}"), on_command, COMMANDS)
        self._thread = threading.Thread(target=self._run, name="servo commands")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._came:
            self._ended = True
            self._came.notify_all()
        self._thread.join()

    # -- in the thread that listens --

    def take(self, topic: str, read: Read, punctuality: Punctuality | None, message: Any) -> None:
        """A command as if it came on this topic; returns quickly."""
        now, stamp = time.monotonic(), message.header.stamp
        if punctuality is not None and punctuality.late(stamp.sec + stamp.nanosec / NANOSECONDS, now):
            self._refuse(f"a message on {topic} came more than {STALE:g} s late; find out what delays it")
            return
        try:
            send = read(message, self._engine.tooled.descriptor, self._look_up)
            command = _Command(topic, now, send, lasting(message))
        except ZarmError as error:
            self._refuse(f"{topic}: {error}")
            return
        with self._came:
            self._newest[topic] = command
            self._came.notify_all()

    def _refuse(self, text: str) -> None:
        self._report(INVALID, text)
        self._log.warning(text, throttle_duration_sec=5.0)

    # -- in its own thread --

    def _run(self) -> None:
        while (command := self._next()) is not None:
            try:
                with self._opens[command.topic]() as session:
                    self._follow(session, command)
            except ZarmError as error:
                text = self._engine.terms.of(str(error))
                log.warning("commands not followed topic=%s reason=%s", command.topic, text)
                self._refuse(f"{text}; then pause the commands for {RELEASE_SECONDS:g} s")
                self._wait_for_release()
            else:
                self._report(NO_WARNING, "no commands")

    def _follow(self, session: Session, command: _Command) -> None:
        """Pass on the commands of one topic until they pause and others come, or none have come for SESSION_SECONDS.

        Raises the session's error.
        """
        topic, last = command.topic, command.time
        newest: _Command | None = command
        while not self._ended and session.running:
            now = time.monotonic()
            if newest is not None and now - newest.time < STALE:
                try:
                    clipped = newest.send(session)
                    if clipped is not None:
                        self._report(STATUS["joint_limit"], clipped)
                except InvalidRequest as error:  # the robot goes on by the commands before
                    self._refuse(f"{topic}: {error}")
                last = newest.time + newest.lasts
            self._report_of(session.state)
            if now - last > SESSION_SECONDS or (now - last > STALE and self._others(topic)):
                return
            newest = self._next(topic, _REPORT_PERIOD)
        if not self._ended:
            raise Cancelled("another client has ended the session of the servo; see who leads the robot")

    def _next(self, topic: str | None = None, timeout: float | None = None) -> _Command | None:
        """The newest command, of that topic if given, once there is one; None after the timeout, or at the end."""
        with self._came:
            self._came.wait_for(lambda: self._ended or self._waiting(topic), timeout)
            waiting = [] if self._ended else self._waiting(topic)
            return self._newest.pop(max(waiting, key=lambda one: one.time).topic) if waiting else None

    def _waiting(self, topic: str | None = None) -> list[_Command]:
        """The commands that still count."""
        fresh = time.monotonic() - STALE
        return [one for one in self._newest.values() if topic in (None, one.topic) and one.time > fresh]

    def _others(self, topic: str) -> bool:
        """Whether there is a command of another topic."""
        with self._came:
            return any(one.topic != topic for one in self._waiting())

    def _wait_for_release(self) -> None:
        while self._next(timeout=RELEASE_SECONDS) is not None:
            pass

    def _report_of(self, state: ServoSession | None) -> None:
        if state is not None and state.refused is not None:
            self._report(INVALID, state.refused.message)
        elif state is not None:
            self._report(STATUS[state.limiting], limited(state))

    def _report(self, code: int, text: str) -> None:
        """Publish each change, and ten times a second while there are commands."""
        now = time.monotonic()
        if (code, text) == self._reported and now - self._reported_at < _REPORT_PERIOD:
            return
        self._reported, self._reported_at = (code, text), now
        self._status.publish(Int8(data=code))
        self._text.publish(String(data=text))
        self.report(code, text)
