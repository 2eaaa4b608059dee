"""What the instrument must survive, one dive each: the texts beside this file."""

from __future__ import annotations

import logging
import subprocess
from pathlib import Path

import pytest

from tests.appliance.instrument.service.test_spoken import REPR
from tests.scenarios.scenario import judge, parse, play

SCENARIOS = sorted(Path(__file__).parent.glob("*.scn"))


@pytest.mark.dive
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_instrument_survives(path: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    scenario = parse(path.read_text(encoding="utf-8"))
    try:
        assert judge(scenario, play(scenario, tmp_path)) == []
        assert [line for line in map(logging.LogRecord.getMessage, caplog.records) if REPR.search(line)] == []
    finally:
        if (tmp_path / "root").is_mount():
            subprocess.run(["umount", "-l", str(tmp_path / "root")], check=True, timeout=20)


def test_a_text_that_is_not_understood_is_refused() -> None:
    with pytest.raises(ValueError, match="line 2: 'after kept 1' is not understood"):
        parse("wait state AIM 3\nafter kept 1\n")
