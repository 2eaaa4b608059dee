"""A dive on which devices come and go: what was accepted is there, and every refusal had its reason on the screen."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

SCANS = 7


def dive(root: Path) -> tuple[int, dict[str, Any]]:
    words = ["sim", "object=plane", "truth=nominal", "size=320x240", "--root", str(root)]
    words += ["chaos=3", f"scans={SCANS}", "--json"]
    ended = subprocess.run([sys.executable, "-m", "appliance.cli", *words], capture_output=True, text=True, check=False)
    assert ended.stdout, ended.stderr[-2000:]
    return ended.returncode, json.loads(ended.stdout)


def test_nothing_accepted_is_lost_and_no_refusal_is_silent(tmp_path: Path) -> None:
    code, told = dive(tmp_path / "root")
    assert told["lost"] == told["damaged"] == told["unexplained"] == []
    assert code == 0
    assert told["scans"] == SCANS
    assert len(told["accepted"]) == told["saved"] > 0
    assert len(told["accepted"]) + told["rejected"] + sum(told["refused"].values()) == SCANS
    assert told["refused"], "nothing went wrong: this was no chaos"
    assert set(told["refused"]) & set(told["alerts"]), "what kept it from a scan was an alert"
