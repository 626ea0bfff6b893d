"""Writes the generated pages of `docs/reference/` from the code. `make docs` runs it; a test holds the pages current."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from pydantic import BaseModel, TypeAdapter

import zarm
from zarm_cli.commands import command_line
from zarm_contract import messages as every_message
from zarm_contract.camera import DescribedCamera
from zarm_contract.collision import CollisionCapsule, CollisionCuboid, CollisionCylinder, CollisionSphere
from zarm_contract.descriptor import (
    CSpace,
    ExecutionSettings,
    MemberRobot,
    Payload,
    RobotDescriptor,
    StatedJointDynamics,
    StrategyParams,
    ToolSpeeds,
)
from zarm_contract.digital_output import DigitalOutput
from zarm_contract.errors import MEANINGS, Problem, ZarmError
from zarm_contract.gripper import Gripper
from zarm_contract.group import JointGroup
from zarm_contract.key import Key, Token
from zarm_contract.keys import declared
from zarm_contract.messages import (
    Message,
    Name,
    SceneRevision,
    agent,
    driver,
    executor,
    goals,
    gripper,
    motion,
    output,
    perception,
    physics,
    planner,
    program,
    scene,
    service,
    servo,
)
from zarm_contract.roles import EVERYONE, SERVICE_ROLES
from zarm_executor.transitions import MODES, TRANSITIONS
from zarm_runtime.settings import SETTINGS

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"
PART, END = "<!-- Made from the code by docs/generate.py: -->", "<!-- Until here. -->"
NOTE = "<!-- Made from the code by docs/generate.py: do not edit. -->"


def pages() -> dict[str, str]:
    """The text of every generated page by the name of its file."""
    made: dict[str, Callable[[], Iterable[str]]] = {
        "keys.md": keys,
        "messages.md": messages,
        "problems.md": problems,
        "settings.md": settings,
        "python.md": python,
        "commands.md": commands,
        "robot.md": robot,
        "metrics.md": metrics,
    }
    return {name: "\n".join([NOTE, "", *make()]).rstrip() + "\n" for name, make in made.items()}


def keys() -> Iterator[str]:
    """Every key with its messages and who may use it."""
    yield from (
        "# Keys",
        "",
        "Every key begins with `zarm/<robot>/`. [The bus](bus.md) explains the kinds of key and how to send a request. *Who* are",
        "the [roles](../how-to/secure-a-bus.md#who-may-do-what) that may send the request, or publish.",
        "",
    )
    headings = {
        "Planner": ("planner",),
        "Scene": ("scene",),
        "Executor": ("executor",),
        "Robot and preview": ("joint_states", "preview"),
        "Servo": ("servo",),
        "Agents": ("agent",),
        "Perception": ("perception",),
        "Driver": ("driver", "leeloo_sim", "physics"),
        "Every service": ("<service>",),
    }
    keys = declared().values()
    for heading, owners in headings.items():
        yield from (f"## {heading}", "")
        yield from _table(
            ("key", "kind", "messages", "who", "what"),
            (
                (f"`{key.path}`", key.kind, _linked(key.messages), _who(key), key.about)
                for key in keys
                if key.path.split("/")[0] in owners
            ),
        )


def _who(key: Key) -> str:
    if isinstance(key, Token):
        return "its service"
    who = key.rights.asks or key.rights.publishes
    return "everyone" if who == EVERYONE else ", ".join(who)


def messages() -> Iterator[str]:
    """Every message with its fields."""
    yield from (
        "# Messages",
        "",
        "JSON objects. Units are SI: m, rad, s. Quaternions are `[x, y, z, w]`; joint vectors follow `joints` in the",
        "[descriptor](robot.md); times of day are Unix seconds. Poses are of the robot's `tip_link` in its `base_link`.",
        "[The bus](bus.md#how-messages-are-written) has the rules for all messages.",
        "",
    )
    modules: dict[str, ModuleType] = {
        "Planning": planner,
        "Goals": goals,
        "Programs": program,
        "The scene": scene,
        "Execution": executor,
        "Grippers": gripper,
        "Outputs": output,
        "Perception": perception,
        "Physics": physics,
        "The servo": servo,
        "Agents": agent,
        "Drivers": driver,
        "Trajectories, joints and poses": motion,
        "Every service": service,
    }
    for heading, module in modules.items():
        yield from (f"## {heading}", "")
        models = [
            model
            for model in vars(module).values()
            if inspect.isclass(model) and issubclass(model, Message) and model.__module__ == module.__name__
        ]
        for model in [*models, Problem] if heading == "Every service" else models:
            yield from (f"### {model.__name__}", "", inspect.getdoc(model) or "", "")
            yield from _fields(model)


def _fields(model: type[BaseModel]) -> Iterator[str]:
    what = _attribute_docs(model)
    described = model.model_json_schema()
    required = described.get("required", [])
    rows = []
    for name, field in described.get("properties", {}).items():
        default = "required" if name in required else _default(field)
        rows.append((f"`{name}`", _type(field), default, *([what[name]] if what else [])))
    if rows:
        yield from _table(("field", "type", "default", *(["what"] if what else [])), rows)


def _attribute_docs(model: type[BaseModel]) -> dict[str, str]:
    """The docstrings below the fields of a class, on one line each."""
    (body,) = ast.parse(inspect.getsource(model)).body
    docs: dict[str, str] = {}
    statements = body.body if isinstance(body, ast.ClassDef) else []
    for field, text in pairwise(statements):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            docs[field.target.id] = " ".join(str(ast.literal_eval(text.value)).split())
    return {name: docs.get(name, "") for name in model.model_fields} if docs else {}


_SECTIONS = {
    "CSpace": "cspace",
    "ToolSpeeds": "tool",
    "Payload": "payload",
    "ExecutionSettings": "execution",
    "StatedJointDynamics": "joint_dynamics",
    "StrategyParams": "strategy_params",
    "Gripper": "gripper",
    "DigitalOutput": "output",
    "DescribedCamera": "camera",
    "JointGroup": "group",
    "MemberRobot": "member of a robot",
    "CollisionSphere": "collision sphere",
    "CollisionCapsule": "collision capsule",
    "CollisionCylinder": "collision cylinder",
    "CollisionCuboid": "collision cuboid",
}
"""The parts of a descriptor, and the headings under which their keys are."""

_PATTERNS = {
    TypeAdapter(Name).json_schema()["pattern"]: "name",
    TypeAdapter(SceneRevision).json_schema()["pattern"]: "revision",
}


def _type(field: dict[str, Any]) -> str:
    """A JSON schema in a few words."""
    if "$ref" in field:
        name = field["$ref"].rsplit("/", 1)[1]
        heading = _SECTIONS.get(name, name)
        return f"[{heading}](#{re.sub('[^a-z_ ]', '', heading.lower()).replace(' ', '-')})"
    if choices := field.get("oneOf") or field.get("anyOf"):
        return " or ".join(_type(choice) for choice in choices if choice.get("type") != "null")
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return ", ".join(f"`{json.dumps(value)}`" for value in field["enum"])
    match field.get("type"):
        case "array":
            return _array(field)
        case "object":
            names = next(iter(field.get("patternProperties", {}).values()), None)
            return f"a mapping of {'links' if names is None else 'names'} to: {_type(names or field['additionalProperties'])}"
        case "string":
            return _PATTERNS.get(field.get("pattern", ""), "text")
        case kind:
            signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
            bounds = [f"{sign} {field[bound]}" for bound, sign in signs.items() if bound in field]
            return " ".join([str(kind), ", ".join(bounds)]).strip()


def _array(field: dict[str, Any]) -> str:
    if "prefixItems" in field:
        kinds = [_type(item) for item in field["prefixItems"]]
        return f"{len(kinds)} × {kinds[0]}" if len(set(kinds)) == 1 else ", ".join(kinds)
    low, high = field.get("minItems", 0), field.get("maxItems")
    count = f"{low} to {high}" if high is not None else f"at least {low}" if low else ""
    return f"list of {count} {_type(field['items'])}".replace("  ", " ")


def _default(field: dict[str, Any]) -> str:
    value = field.get("default")
    return "" if value is None or isinstance(value, dict) else f"`{json.dumps(value, ensure_ascii=False)}`"


def problems() -> Iterator[str]:
    """Every code of a problem."""
    yield from (
        "# Problems",
        "",
        "A request is answered with its reply or with an error reply, a [Problem](messages.md#problem). Its `message` says what",
        "to do next. In Python each code is an exception.",
        "",
    )
    of = {code: cls.__name__ for cls in ZarmError.__subclasses__() for code in cls.codes}
    yield from _table(
        ("code", "exception", "what it means", "what to do"),
        ((f"`{code}`", f"`{of[code]}`", *meaning) for code, meaning in MEANINGS.items()),
    )


def settings() -> Iterator[str]:
    """Every environment variable, and the options of each service."""
    yield from (
        "# Settings",
        "",
        "A command-line option overrides its environment variable. The [descriptor](robot.md) holds the settings of the robot.",
        "",
        "## Environment variables",
        "",
    )
    yield from _table(
        ("variable", "option", "default", "what"),
        ((f"`{one.name}`", f"`{one.option}`" if one.option else "", one.default, one.what) for one in SETTINGS),
    )
    yield from ("## Options of every service", "")

    yield from _table(("option", "what"), _options(_source_of("def service_parser(")))
    for name in (*SERVICE_ROLES, "viewer"):
        (source,) = (ROOT / "services").glob(f"{name}/zarm_{name}/service.py")
        shared = [
            _source_of(f"def {name}(") for name in ("add_meshes", "add_options") if f"{name}(" in source.read_text()
        ]
        if rows := [row for path in (source, *shared) for row in _options(path)]:
            yield from (f"## `zarm-{name.replace('_', '-')}`", "")
            yield from _table(("option", "what"), rows)


def _source_of(text: str) -> Path:
    (found,) = (path for path in _sources() if text in path.read_text())
    return found


def _sources() -> Iterator[Path]:
    yield from sorted(path for folder in ("libs", "services") for path in (ROOT / folder).rglob("zarm_*/**/*.py"))


def _calls(path: Path, *names: str) -> Iterator[ast.Call]:
    """Every call of a method with one of these names."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in names:
            yield node


def _options(path: Path) -> Iterator[tuple[str, str]]:
    """The options that a file adds to an argument parser, and their help."""
    for call in _calls(path, "add_argument"):
        given = {keyword.arg: keyword.value for keyword in call.keywords}
        flag = str(ast.literal_eval(call.args[0]))
        if "choices" in given:
            value = "|".join(ast.literal_eval(given["choices"]))
        elif "action" in given and ast.literal_eval(given["action"]) == "store_true":
            value = ""
        else:
            value = str(ast.literal_eval(given["metavar"])) if "metavar" in given else flag.removeprefix("--").upper()
        yield f"`{f'{flag} {value}'.strip()}`", _sentence(str(ast.literal_eval(given["help"])))


def commands() -> Iterator[str]:
    """Every command of `zarm` with its arguments and options; those that nearly all have stand once, at the beginning."""
    every = dict(_commands(typer.main.get_command(command_line()), "zarm"))
    seen = Counter(row for command in every.values() for row in map(_parameter, command.params))
    common = [row for row, count in seen.items() if count > len(every) / 2]
    yield from (
        "# Commands",
        "",
        "`zarm COMMAND --help` shows the same. Lengths are in m, angles in rad, quaternions `x,y,z,w`.",
        "[The command line](command-line.md) has exit codes, files and what Ctrl-C does.",
        "",
        "## Common options",
        "",
    )
    yield from _table(("", "what", "default"), common)
    for name, command in every.items():
        rows = [_parameter(one) for one in command.params if one.name != "help"]
        yield from (f"## `{name}`", "", " ".join((command.help or "").split()), "")
        yield from _table(("", "what", "default"), [row for row in rows if row not in common])
        if also := [row[0] for row in rows if row in common]:
            yield from (f"Also {', '.join(also)}: see [common options](#common-options).", "")


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The commands under one, by the words that name them; itself, where there are none."""
    inner: dict[str, Any] = getattr(command, "commands", {})
    if not inner:
        yield name, command
    for word, nested in inner.items():
        yield from _commands(nested, f"{name} {word}")


def _parameter(parameter: Any) -> tuple[str, str, str]:
    what, _, shown = (parameter.help or "").partition("[default: ")
    value = parameter.default
    if not shown and isinstance(value, (str, int, float)) and not isinstance(value, bool):
        shown = str(value)
    default = f"`{shown.rstrip(']').replace(str(Path.home()), '~')}`" if shown else ""
    if parameter.param_type_name == "argument":
        return f"`{parameter.metavar or parameter.name.upper()}`", _sentence(what), default
    names = ", ".join(f"`{name}`" for name in [*parameter.opts, *parameter.secondary_opts])
    variable = f" [`{parameter.envvar}`](settings.md)" if parameter.envvar else ""
    return names, _sentence(what) + variable, default


def robot() -> Iterator[str]:
    """Every key of the descriptor."""
    yield from (
        "# Robot descriptor",
        "",
        f"{inspect.getdoc(RobotDescriptor)} [Add a robot](../how-to/add-a-robot.md) shows how to write",
        "one. Every list with one value per joint follows `joints`. Joint limits of position come from the URDF; a `continuous`",
        "joint has none: it turns freely, angles that differ by whole turns are the same, and goals are reached the short way.",
        "",
    )
    parts = (
        CSpace,
        ToolSpeeds,
        Payload,
        ExecutionSettings,
        StatedJointDynamics,
        StrategyParams,
        CollisionSphere,
        CollisionCapsule,
        CollisionCylinder,
        CollisionCuboid,
        Gripper,
        DigitalOutput,
        JointGroup,
        MemberRobot,
        DescribedCamera,
    )
    for model in (RobotDescriptor, *parts):
        if model is not RobotDescriptor:
            yield from (f"## {_SECTIONS[model.__name__]}", "", inspect.getdoc(model) or "", "")
        what = _attribute_docs(model)
        if missing := [name for name in model.model_fields if not what.get(name) and name != "kind"]:
            raise TypeError(f"{model.__name__}: write a docstring below {', '.join(missing)}")
        yield from _fields(model)


def metrics() -> Iterator[str]:
    """Every metric that a service counts."""
    yield from (
        "# Metrics",
        "",
        "With `pip install 'zarm[metrics]'` and `ZARM_METRICS=127.0.0.1:9464` (or `--metrics`) a service answers",
        "`http://127.0.0.1:9464/metrics` in the format of Prometheus. Every metric has the label `robot`. The process adds `process_*`:",
        "CPU time, memory and open files. [Watch it run](../how-to/commission-a-robot.md#what-to-look-at) has useful alerts.",
        "",
    )
    kinds = {"count": "counter", "time": "histogram", "read_histogram": "histogram"}
    rows = []
    for path in _sources():
        for call in _calls(path, "count", "time", "read", "read_histogram"):
            texts = [ast.literal_eval(one) for one in call.args if isinstance(one, ast.Constant)]
            name = next((text for text in texts if str(text).startswith("zarm_")), None)
            if name is None:
                continue
            method = call.func.attr if isinstance(call.func, ast.Attribute) else ""
            kind = kinds.get(method) or str(texts[0])
            labels = ", ".join(f"`{one.arg}`" for one in call.keywords if one.arg not in (None, "by"))
            package = next(part for part in path.parts if part.startswith("zarm_"))
            service = package.removeprefix("zarm_")
            rows.append(
                (
                    f"`{name}{'_total' if kind == 'counter' else ''}`",
                    kind,
                    labels,
                    service if service in SERVICE_ROLES else "all",
                    str(texts[texts.index(name) + 1]),
                )
            )
    yield from _table(("name", "kind", "labels", "from", "what"), sorted(rows, key=lambda row: (row[3], row[0])))


def python() -> Iterator[str]:
    """Everything that `import zarm` offers: functions, classes with their methods, values, messages and errors."""
    public = {name: getattr(zarm, name) for name in zarm.__all__}
    own = {name: one for name, one in public.items() if getattr(one, "__module__", "").partition(".")[0] == "zarm"}
    modules = {module.__name__ for module in (zarm.values, zarm.motions, zarm.objects)}
    values = {name: one for name, one in own.items() if one.__module__ in modules}
    yield from ("# Python", "", *_docstring(zarm), "## Functions", "")
    for name, function in own.items():
        if inspect.isfunction(function):
            yield from _described(f"zarm.{name}", function)
    for name in ("Robot", "PlanOptions", "Scene", "Tracking", "Jogging", "Stream", "Story"):
        yield from (f"## {name}", "", *_docstring(own[name]))
        for method, member in sorted(inspect.getmembers(own[name]), key=_place):
            if not method.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
                yield from _described(method, member)
    yield from ("## Goals, objects and trajectories", "")
    for name, model in values.items():
        yield from _described(f"zarm.{name}", model)
    others = [
        name for name, one in public.items() if getattr(one, "__module__", "").startswith("zarm_contract.messages")
    ]
    yield from ("## Messages and errors", "", f"Calls return {_linked(', '.join(others))}.")
    errors = (f"`{name}`" for name, one in public.items() if inspect.isclass(one) and issubclass(one, ZarmError))
    yield from (f"Errors, of which every [problem](problems.md) is one: {', '.join(errors)}.", "")


def _place(member: tuple[str, Any]) -> tuple[str, int]:
    """Where a method stands: the methods of one file in their order there."""
    function = inspect.unwrap(member[1].fget if isinstance(member[1], property) else member[1])
    return (function.__module__, function.__code__.co_firstlineno) if inspect.isfunction(function) else ("", 0)


def _described(name: str, member: Any) -> Iterator[str]:
    """A function, a method, a property or a class: how it is called, and its docstring."""
    if isinstance(member, property):
        call = f"{name}: {inspect.signature(member.fget).return_annotation}"
    else:
        found = inspect.signature(member.__init__ if inspect.isclass(member) else member)
        called = [one for one in found.parameters.values() if one.name != "self"]
        returned = inspect.Signature.empty if inspect.isclass(member) else found.return_annotation
        written = str(found.replace(parameters=called, return_annotation=returned))
        call = name + re.sub(r"""(: |-> )(['"])(.*?)\2""", r"\1\3", written)  # annotations are texts
    yield from (f"### {name}", "", "```python", *_wrapped(call), "```", "", *_docstring(member))


def _wrapped(call: str) -> list[str]:
    """A call that is too long for a line with one parameter per line."""
    if len(call) <= 100:
        return [call]
    head, _, rest = call.partition("(")
    inside, _, end = rest.rpartition(")")
    depth, parts = 0, [""]
    for sign in inside:
        depth += (sign in "([{") - (sign in ")]}")
        if sign == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += sign
    return [f"{head}(", *(f"    {part.strip()}," for part in parts), f"){end}"]


def _docstring(member: Any) -> list[str]:
    return [*(inspect.getdoc(member) or "").splitlines(), ""]


def _linked(text: str) -> str:
    """A text with every name of a message as a link to it."""
    names = {name for name in every_message.__all__ if hasattr(getattr(every_message, name), "model_fields")}
    return re.sub(
        r"\w+",
        lambda word: f"[{word[0]}](messages.md#{word[0].lower()})" if word[0] in names else word[0],
        text.replace("->", "→"),
    )


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """A table, and a blank line after it; nothing where there are no rows."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    if lines:
        yield from ("| " + " | ".join(heads) + " |", "|---" * len(heads) + "|", *lines, "")


def parts() -> dict[Path, str]:
    """The text of every page that has a generated part, between two comments."""
    made = {ROOT / "services/executor/README.md": mode_diagram(), ROOT / "docs/explanation/execution.md": mode_table()}
    return {page: _with_part(page.read_text(), part) for page, part in made.items()}


def _with_part(page: str, part: Iterable[str]) -> str:
    before, rest = page.split(PART, 1)
    return f"{before}{PART}\n" + "\n".join(part).rstrip() + f"\n{END}" + rest.split(END, 1)[1]


def mode_diagram() -> Iterator[str]:
    """The modes of the executor as a diagram."""
    yield from ("", "```mermaid", "stateDiagram-v2", "    [*] --> idle")
    for before, after, causes in TRANSITIONS:
        yield f"    {before} --> {after}: {', '.join(causes)}"
    yield from ("```", "")


def mode_table() -> Iterator[str]:
    """The modes of the executor as a table."""
    yield ""
    rows = (
        (
            f"`{mode}`",
            meaning,
            "<br>".join(f"`{arrow.after}`: {', '.join(arrow.causes)}" for arrow in TRANSITIONS if arrow.before == mode),
        )
        for mode, meaning in MODES.items()
    )
    yield from _table(("mode", "meaning", "left for"), rows)


def main() -> None:
    """Write every page."""
    REFERENCE.mkdir(exist_ok=True)
    for name, text in pages().items():
        (REFERENCE / name).write_text(text)
    for page, text in parts().items():
        page.write_text(text)


if __name__ == "__main__":
    main()
