"""Logs: one line per event, the service first or a JSON object, whatever the event."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

LINE = re.compile(r"planner   \| \d\d:\d\d:\d\d level=[A-Z]+ \S.*")


def logged(program: str, **environment: str) -> list[str]:
    """What a process writes to standard error that logs as the planner does."""
    prelude = "import logging; from zarm_runtime.logs import setup_logging; setup_logging('planner'); log = logging.getLogger('x')\n"
    clean = {name: value for name, value in os.environ.items() if not name.startswith("ZARM_")}
    done = subprocess.run(
        [sys.executable, "-c", prelude + program], env=clean | environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == ""
    return done.stderr.splitlines()


def test_an_event_is_one_line_with_service_time_level_and_values() -> None:
    (line,) = logged("log.info('planned goal_id=%s seconds=%.2f', 'g1', 0.25)")
    assert LINE.fullmatch(line)
    assert line.endswith(" level=INFO planned goal_id=g1 seconds=0.25")


def test_every_line_of_a_trace_carries_the_service() -> None:
    lines = logged("try:\n  1 / 0\nexcept ZeroDivisionError:\n  log.exception('failed key=%s', 'k')")
    assert LINE.fullmatch(lines[0])
    assert len(lines) > 2
    assert all(line.startswith("planner   | ") for line in lines)
    assert "ZeroDivisionError" in lines[-1]


def test_the_level_comes_from_the_environment() -> None:
    program = "log.debug('a'); log.info('b'); log.error('c')"
    assert [line[-1] for line in logged(program)] == ["b", "c"]
    assert [line[-1] for line in logged(program, ZARM_LOG="error")] == ["c"]
    assert [line[-1] for line in logged(program, ZARM_LOG="DEBUG")] == ["a", "b", "c"]


def test_an_unknown_level_is_said_and_info_is_used() -> None:
    warning, line = logged("log.debug('a'); log.info('b')", ZARM_LOG="loud")
    assert "level=WARNING" in warning
    assert "ZARM_LOG=LOUD" in warning
    assert line.endswith("level=INFO b")


def test_colour_is_there_only_on_request() -> None:
    (plain,) = logged("log.info('b')")
    (coloured,) = logged("log.info('b')", ZARM_COLOUR="1")
    assert "\x1b" not in plain
    assert re.sub(r"\x1b\[\d+m", "", coloured)[:12] == plain[:12]
    assert coloured.startswith("\x1b[36m")


def test_a_flood_of_warnings_is_limited_and_says_so() -> None:
    lines = logged("for n in range(1000):\n  log.warning('dropped n=%d', n)\n  log.info('served')\nlog.error('other')")
    dropped = [line for line in lines if "dropped" in line]
    assert len(dropped) == 20
    assert dropped[-1].endswith(" dropped n=19 further=left_out_for_10_s")
    assert not any("further" in line for line in dropped[:-1])
    assert sum("served" in line for line in lines) == 1000
    assert "level=ERROR other" in lines[-1]


def test_after_a_flood_the_next_warning_is_logged_again() -> None:
    prelude = "from zarm_runtime import logs\ndef drop(n): log.warning('dropped n=%d', n)\n"
    lines = logged(prelude + "for n in range(100): drop(n)\nlogs.BURST_PERIOD = 0.0\ndrop(100)")
    assert len(lines) == 21
    assert "dropped n=100" in lines[-1]


def objects(program: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in logged(program, ZARM_LOG_FORMAT="json", ZARM_COLOUR="1")]


def test_an_event_is_one_json_object() -> None:
    (plain, named) = objects(
        "log.info('planned goal_id=%s seconds=%.2f count=%d remedy=add_%s_GB', 'g1', 0.256, 3, 4)\n"
        "from zarm_runtime.logs import name_robot; name_robot('arm')\n"
        "log.warning('the loop %s failed; 100%% reason=%s', 'control', 'left by 0.2 rad (a=1); \\n see \"why\"')"
    )
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", str(plain.pop("time")))
    assert plain == {
        "level": "INFO",
        "service": "planner",
        "message": "planned",
        "fields": {"goal_id": "g1", "seconds": 0.256, "count": 3, "remedy": "add_4_GB"},
    }
    assert (named["robot"], named["level"]) == ("arm", "WARNING")
    assert named["message"] == "the loop control failed; 100%"
    assert named["fields"] == {"reason": 'left by 0.2 rad (a=1); \n see "why"'}


def test_a_trace_and_a_flood_are_json_too() -> None:
    lines = objects(
        "try:\n  1 / 0\nexcept ZeroDivisionError:\n  log.exception('failed key=%s', 'k')\n"
        "for n in range(30):\n  log.warning('dropped n=%d', n)\n"
        "log.info('half 50% done'); log.info('by name %(a)s', {'a': 1})"
    )
    assert "ZeroDivisionError: division by zero" in str(lines[0]["trace"])
    assert lines[0]["fields"] == {"key": "k"}
    assert lines[20]["fields"] == {"n": "19", "further": "left_out_for_10_s"}
    assert [line["message"] for line in lines[21:]] == ["half 50% done", "by name 1"]


def test_an_unknown_format_is_said_and_text_is_used() -> None:
    warning, line = logged("log.info('b')", ZARM_LOG_FORMAT="xml")
    assert "ZARM_LOG_FORMAT=xml using=text" in warning
    assert line.endswith("level=INFO b")
