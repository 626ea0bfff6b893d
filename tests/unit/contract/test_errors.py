"""Problems on the wire and exceptions in the code stand for each other, one to one."""

from __future__ import annotations

from typing import get_args

import pytest

from zarm_contract import errors
from zarm_contract.errors import Code, ExecutionRefused, InvalidRequest, Problem, ZarmError, from_problem

EXCEPTIONS = ZarmError.__subclasses__()
CODES = get_args(Code)


def test_every_problem_code_has_exactly_one_exception_class() -> None:
    assert sorted(code for cls in EXCEPTIONS for code in cls.codes) == sorted(CODES)


def test_the_documented_tree_is_the_class_hierarchy() -> None:
    drawn = [line.split()[1] for line in (errors.__doc__ or "").splitlines() if "── " in line]
    assert drawn == [cls.__name__ for cls in EXCEPTIONS]


@pytest.mark.parametrize("code", CODES)
def test_a_problem_becomes_its_exception_and_is_kept_whole(code: Code) -> None:
    problem = Problem(code=code, message="Something is wrong; do this.", field="goal.position.2", joint="elbow")
    error = from_problem(problem)
    assert type(error) in EXCEPTIONS
    assert code in error.codes
    assert error.code == code
    assert error.problem == problem


def test_an_exception_s_default_code_is_its_class_s_first() -> None:
    assert ExecutionRefused("too fast").code == "limit_violated"
    assert ExecutionRefused("too old", code="stale_plan").code == "stale_plan"


def test_an_exception_cannot_carry_the_code_of_another_class() -> None:
    with pytest.raises(TypeError, match="InvalidRequest cannot carry the code busy"):
        InvalidRequest("no", code="busy")


def test_an_exception_prints_its_sentence_and_the_place_at_fault() -> None:
    assert str(InvalidRequest("give a number", field="goal.position.2")) == "give a number (goal.position.2)"
    assert str(ExecutionRefused("too fast", joint="elbow")) == "too fast (elbow)"
    assert str(InvalidRequest("give a number")) == "give a number"
