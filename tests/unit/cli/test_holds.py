"""What a held goal waits for is said in words of its own."""

from __future__ import annotations

from typing import get_args

from zarm_cli.output import held_by
from zarm_contract.messages import Hold, Obstruction


def test_each_reason_has_its_own_words() -> None:
    reasons = get_args(Hold.model_fields["reason"].annotation)
    beside = Obstruction(object="post", link="link_5", time=1.0)
    said = {
        reason: held_by(Hold(reason=reason, obstruction=beside if reason == "obstruction" else None))
        for reason in reasons
    }
    assert len({*said.values()}) == len(reasons)
    assert said["obstruction"] == "post is in the way of link_5 at 1.00 s of the trajectory"
    assert said["output"] == "an output is being switched"
