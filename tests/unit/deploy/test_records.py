"""Records of faults can be downloaded from the page of the composition."""

from __future__ import annotations

import yaml

from support.paths import ROOT


def test_the_viewer_reads_executor_state_and_cannot_write_it() -> None:
    services = yaml.safe_load((ROOT / "deploy" / "compose.yaml").read_text())["services"]
    records = services["viewer"]["environment"]["ZARM_RECORDS"]
    kept = next(
        volume.partition(":")[0] for volume in services["executor"]["volumes"] if volume.endswith("/var/lib/zarm")
    )
    assert f"{kept}:{records}:ro" in services["viewer"]["volumes"]
