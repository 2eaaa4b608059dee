"""What a diver can wait to see is judged from the status file as the product documents it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hw_sim.people import computer, status_file

STATUS = {
    "state": "AIM",
    "alerts": [{"code": "FRAME_MISSING", "headline": "INCOMPLETE 23/24", "action": "REPEAT"}],
    "keys": {"scan": "REPEAT"},
    "devices": {"keys": "lost"},
    "scans": 3,
    "guidance": {"words": "50 %: SCAN NOW", "toward": None},
    "calibration": None,
}


@pytest.mark.parametrize(
    ("seen", "not_seen"),
    [
        ("state AIM", "state REVIEW"),
        ("alert FRAME_MISSING", "alert LEAK"),
        ("gone LEAK", "gone FRAME_MISSING"),
        ("headline INCOMPLETE 23/24", "headline INCOMPLETE 22/24"),
        ("headline INCOMPLETE *", "headline COMPLETE *"),
        ("action REPEAT", "action REPEA"),
        ("label scan REPEAT", "label back REPEAT"),
        ("device keys lost", "device board lost"),
        ("scans 3", "scans 4"),
        ("guidance *SCAN NOW", "guidance *GO BACK"),
    ],
)
def test_what_is_there_is_seen_and_nothing_else(seen: str, not_seen: str) -> None:
    for sentence, there in ((seen, True), (not_seen, False)):
        kind, *words = sentence.split()
        status_file.check(kind, words)
        assert status_file.is_met(STATUS, kind, words) is there


def test_without_a_status_nothing_is_seen_not_even_that_an_alert_is_gone() -> None:
    assert not status_file.is_met({}, "gone", ["LEAK"])
    assert not status_file.is_met({}, "state", ["AIM"])


def test_a_disk_that_is_taken_away_refuses_and_comes_back_as_it_was(tmp_path: Path) -> None:
    status = tmp_path / "run" / "status.json"
    (tmp_path / "scans" / "000001").mkdir(parents=True)
    computer.happen(("disk", "off"), status)
    with pytest.raises(OSError):
        (tmp_path / "scans" / "000002").mkdir()
    computer.happen(("disk", "on"), status)
    assert [path.name for path in (tmp_path / "scans").iterdir()] == ["000001"]
    with pytest.raises(ValueError, match="not off"):
        computer.happen(("disk", "on"), status)


def test_the_process_that_the_status_names_is_killed(tmp_path: Path) -> None:
    status = tmp_path / "run" / "status.json"
    status.parent.mkdir()
    with pytest.raises(ValueError, match="no process"):
        computer.happen(("worker", "kill"), status)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as process:
        status.write_text(json.dumps({"worker_pid": process.pid}))
        computer.happen(("worker", "kill"), status)
        assert process.wait(10) == -9
