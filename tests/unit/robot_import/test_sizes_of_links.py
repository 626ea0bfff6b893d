"""A link in the wrong unit is asked about, and flat geometry is a thin solid: neither is taken or lost in silence."""

from __future__ import annotations

from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_robot_import.importing import Options, import_robot


def arm(tmp_path: Path, tip: str) -> Path:
    """An arm of three joints that reaches 0.9 m, with this geometry at its tip."""
    links = "".join(
        f'<link name="l{i}"><collision><geometry><box size="0.05 0.05 0.2"/></geometry></collision></link>'
        for i in range(3)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="{child}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>'
        '<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
        for i, child in enumerate(("l1", "l2", "tool"))
    )
    tool = f'<link name="tool"><collision><origin xyz="0 0 0.2"/><geometry>{tip}</geometry></collision></link>'
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{links}{tool}{joints}</robot>')
    return file


def test_a_link_in_mm_is_refused_with_the_question_asked(tmp_path: Path) -> None:
    file = arm(tmp_path, '<box size="0.1 0.1 18"/>')
    with pytest.raises(InvalidRequest, match=r"link tool is 18 m large on an arm that reaches .*--right-size tool"):
        import_robot(file, tmp_path / "out", Options())
    assert not (tmp_path / "out").exists()


def test_a_mesh_scaled_twice_is_refused_with_the_question_asked(tmp_path: Path) -> None:
    (tmp_path / "tool.obj").write_text("v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 300\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    file = arm(tmp_path, '<mesh filename="tool.obj" scale="0.000001 0.000001 0.000001"/>')
    with pytest.raises(InvalidRequest, match=r"link tool is smaller than 1 mm: .*--right-size tool"):
        import_robot(file, tmp_path / "out", Options())
    _, report = import_robot(file, tmp_path / "out", Options(right_size=("tool",)))
    assert any("smaller than 1 mm, so it is left out" in warning for warning in report.warnings)


@pytest.mark.parametrize("flat", ['<cylinder radius="0.1" length="0"/>', '<box size="0.1 0.1 0"/>'])
def test_flat_geometry_is_a_thin_solid_and_said(tmp_path: Path, flat: str) -> None:
    _, report = import_robot(arm(tmp_path, flat), tmp_path / "out", Options())
    assert any("is flat, so it is taken as 1 mm thick" in warning for warning in report.warnings)
    assert "tool" in {surface.link for surface in report.surfaces}
