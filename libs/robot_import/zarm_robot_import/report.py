"""The report of an import."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from zarm_robot_import.chain import Chain
from zarm_robot_import.fitting import Fitted
from zarm_robot_import.gripper import ImportedGripper
from zarm_robot_import.limits import FASTEST, SMALLEST, WIDEST, JointLimits
from zarm_robot_import.meshes import Surface
from zarm_robot_import.self_collision import Pair


@dataclass(frozen=True)
class Report:
    """All decisions, and their reasons.

    `notes` name the geometry not used, and inertias that no body has; `controller` is the ros2_control trajectory controller that the URDF names.
    """

    name: str
    source: str
    chain: Chain
    surfaces: Sequence[Surface]
    fitted: Sequence[Fitted]
    limits: Sequence[JointLimits]
    pairs: Sequence[Pair]
    home: Sequence[float]
    notes: Sequence[str]
    seconds: float
    controller: str | None = None
    grippers: Mapping[str, ImportedGripper] = field(default_factory=dict)

    @property
    def standing(self) -> list[tuple[str, float]]:
        """Joints outside of the arm that stand, and where."""
        moving = {name for one in self.grippers.values() for name in (one.joint.name, *one.followers)}
        return [(name, value) for name, value in self.chain.fixed if name not in moving]

    def opening(self) -> str:
        """What is known of the grippers, in a sentence for each."""
        if not self.grippers:
            return "They stand fixed: they have several drives, or were fixed, or what they move does not open."
        return " ".join(map(_opening, self.grippers.values()))

    @property
    def gripper_in_short(self) -> str:
        """The drives of the grippers and how far they open, or the joints that stand."""
        if not self.grippers:
            return f"{', '.join(self.chain.gripper)}, fixed"
        return "; ".join(
            f"{gripper.joint.name}, opens {1e3 * gripper.widths[-1]:.0f} mm" for gripper in self.grippers.values()
        )

    @property
    def warnings(self) -> list[str]:
        """What should be reviewed."""
        found = [*self.notes, *self.chain.mimics]
        found += [f"{surface.link}: {warning}" for surface in self.surfaces for warning in surface.warnings]
        for joint, limit in zip(self.chain.joints, self.limits, strict=True):
            for what in ("range", "velocity"):
                if what in limit.assumed:
                    found.append(
                        f"{limit.joint}: the URDF gives no {what}, so it is assumed; correct it in the descriptor or URDF"
                    )
            turns = joint.type == "continuous"
            stated = (
                f"{limit.joint}: {f'a range from {limit.lower:g} to {limit.upper:g}' if not turns else 'a joint that turns freely'} "
                f"at a velocity of {limit.velocity:g}"
            )
            if (not turns and max(-limit.lower, limit.upper) > WIDEST) or limit.velocity > FASTEST:
                wrong, unit = ("mm", "m") if joint.type == "prismatic" else ("degrees", "rad")
                found.append(f"{stated} is most likely in {wrong}; write {unit} and {unit}/s into the URDF")
            elif min(limit.upper - limit.lower, limit.velocity) < SMALLEST:
                found.append(f'{stated} lets it hardly move; correct the limits in the URDF, or give it type="fixed"')
        found += [f"{joint.name}: it is {joint.type}; here it stands at its origin" for joint in self.chain.free]
        return found

    @property
    def spheres(self) -> int:
        """Spheres in the cover."""
        return sum(len(link.balls) for link in self.fitted)

    def markdown(self) -> str:
        """The page."""
        chain = self.chain
        lines = [
            f"# {self.name}",
            "",
            f"Made by `zarm robot import` from `{self.source}` in {self.seconds:.0f} s of computing time.",
            "",
            f"![{self.name}]({self.name}.png)",
            "",
            f"The chain leads from `{chain.base}` to {' and '.join(f'`{tip}`' for tip in chain.tips)} over {len(chain.joints)} joints. Home: "
            f"{', '.join(f'{value:.2f}' for value in self.home)} rad.",
            "",
            f"The arm's joints: {', '.join(f'`{joint.name}`' for joint in chain.joints)}. {chain.reason}",
        ]
        if chain.groups:
            named = (
                f"`{group.name}` moves `{group.tip}` with {', '.join(f'`{joint}`' for joint in group.joints)}"
                for group in chain.groups
            )
            lines += ["", f"Groups: {'; '.join(named)}."]
        if chain.gripper:
            lines += ["", f"Taken as a gripper: {', '.join(f'`{name}`' for name in chain.gripper)}. {self.opening()}"]
        if self.standing:
            lines += [
                "",
                "Joints outside the chain, fixed: "
                + ", ".join(f"`{name}` at {value:g}" for name, value in self.standing)
                + ".",
            ]
        if self.controller:
            lines += [
                "",
                f"On ROS the arm's driver is the trajectory controller `{self.controller}`, which the URDF names.",
            ]
        if self.warnings:
            lines += ["", "## Look at this", "", *(f"- {warning}" for warning in self.warnings)]
        lines += [
            "",
            "## Geometry",
            "",
            f"The exact geometry contains the surface of every mesh that is taken, and the sphere cover ({self.spheres} spheres) the exact "
            "geometry; both are proven, not sampled. How far they stand out of the meshes is sampled, from above; and so is, to some 1 mm, "
            "whether a visual mesh sticks out of the collision geometry.",
            "",
            "| link | taken | because | triangles | exact geometry | mean, largest (mm) | cover | mean, largest (mm) |",
            "|---|---|---|---|---|---|---|---|",
        ]
        for surface, link in zip(self.surfaces, self.fitted, strict=True):
            numbers = (
                f"{count} | {1e3 * out.mean:.1f}, {1e3 * out.most:.1f}"
                for count, out in ((_counted(link), link.exact_out), (len(link.balls), link.cover_out))
            )
            lines.append(
                f"| {surface.link} | {surface.kind} | {surface.reason} | {len(surface.triangles)} | {' | '.join(numbers)} |"
            )
        lines += [
            "",
            "## Limits",
            "",
            "| joint | lower | upper | velocity | acceleration | jerk | assumed |",
            "|---|---|---|---|---|---|---|",
        ]
        for limit in self.limits:
            values = (limit.lower, limit.upper, limit.velocity, limit.acceleration, limit.jerk)
            shown = " | ".join(f"{value:.4g}" for value in values)
            lines.append(f"| {limit.joint} | {shown} | {', '.join(limit.assumed)} |")
        lines += ["", "## Self-collision", "", "| pair | checked | reason |", "|---|---|---|"]
        lines += [
            f"| {pair.first}, {pair.second} | {'no' if pair.ignored else 'exactly' if pair.exact else 'yes'} | {pair.reason} |"
            for pair in self.pairs
        ]
        return "\n".join(lines) + "\n"


def _opening(gripper: ImportedGripper) -> str:
    follow = f", followed by {', '.join(f'`{name}`' for name in gripper.followers)}" if gripper.followers else ""
    return (
        f"`{gripper.joint.name}` drives it{follow}; it opens from {1e3 * gripper.widths[0]:.0f} to {1e3 * gripper.widths[-1]:.0f} mm, "
        f"measured between the meshes of {' and '.join(f'`{pad}`' for pad in gripper.pads)}."
    )


def _counted(link: Fitted) -> str:
    kinds = Counter(primitive.kind for primitive in link.primitives)
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
