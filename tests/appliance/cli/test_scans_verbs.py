"""Stored scans from the command line: what is there, what is damaged, in words and as JSON."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.machine.ashore import ASHORE
from appliance.scan.fault import FaultCode
from appliance.scan.verdict import Verdict
from appliance.storage.library import Library
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, cloud, frames, record


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two saved scans, one without a trusted clock, and a rejected one."""
    root = tmp_path / "root"
    library = Library(root)
    library.prepare()
    first = library.begin(frames(1), record(), ORIGIN)
    first.publish(record(cloud={"points": 20}), cloud(), PREVIEW)
    second = library.begin(frames(2), record(), ORIGIN)
    second.publish(record(clock_trusted=True))
    library.begin(frames(3), record(), ORIGIN).reject("moved 3 px")
    return root


def damage(root: Path, scan_id: str) -> None:
    path = root / "scans" / scan_id / "frames_left.npy"
    raw = bytearray(path.read_bytes())
    raw[-3] ^= 1
    path.write_bytes(raw)


def test_list_shows_each_scan_with_its_state(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "list", "--root", str(root)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["SCAN", "STATE", "GRADE", "TIME", "POINTS", "OBJECT", "MB", "NAME", "REMARK", "NOTE"]
    assert lines[1].split()[:2] == ["000001", "saved"]
    assert "2031-05-06T07:08:09+00:00 ?" in lines[1]
    assert "20" in lines[1]
    assert "+00:00 ?" not in lines[2]
    assert len(lines) == 3


def test_the_list_says_what_the_screen_said_and_notes_are_the_users(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`failed: motion, causes` stood in the column of the notes, of a scan that the screen had called good."""
    library = Library(root)
    numbers = {"points": 20, "coverage_percent": 82.0, "noise_mm": 0.02}
    moved = Verdict("motion", False, {}, "7 px"), Verdict("compensation", True)
    told = Verdict("causes", False, {"compensated_percent": 0.0, "too_bright_percent": 7.0})
    for word, causes in (("good", ()), ("usable", (told,))):
        kept = record(cloud=numbers, verdicts=(*moved, *causes, Verdict("grade", True, {}, word)))
        library.begin(frames(), kept, ORIGIN).publish(kept, cloud())
    assert main(["scans", "note", "000004", "the bow", "--root", str(root)]) == 0
    capsys.readouterr()
    assert main(["scans", "list", "--root", str(root)]) == 0
    *_, good, usable = capsys.readouterr().out.splitlines()
    assert good.split()[2] == "GOOD"
    assert usable.split()[2] == "USABLE"
    assert "MOTION CORRECTED" in good
    assert good.endswith("the bow")
    assert usable.rstrip().endswith("MOTION CORRECTED, TOO BRIGHT")
    assert main(["scans", "list", "--json", "--root", str(root)]) == 0
    last = json.loads(capsys.readouterr().out)[-1]
    assert (last["grade"], last["corrected"], last["note"]) == ("usable", True, None)


def test_list_all_adds_the_rejected_with_the_reason(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "list", "--all", "--root", str(root)]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("000003  rejected")
    assert last.endswith("moved 3 px")


def test_list_as_json_is_one_document(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "list", "--json", "--root", str(root)]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [one["scan"] for one in listed] == ["000001", "000002"]
    assert [one["points"] for one in listed] == [20, None]
    assert all(one["ok"] for one in listed)


def test_a_damaged_scan_is_marked_and_the_others_are_fine(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage(root, "000001")
    assert main(["scans", "verify", "--root", str(root)]) == 4
    out = capsys.readouterr().out
    assert "000001  DAMAGED: frames_left.npy: damaged" in out
    assert "000002  ok" in out
    assert "2 checked, 1 damaged" in out
    assert main(["scans", "verify", "2", "--root", str(root)]) == 0
    capsys.readouterr()
    assert main(["scans", "verify", "--json", "--root", str(root)]) == 4
    report = json.loads(capsys.readouterr().out)
    assert (report["checked"], report["damaged"]) == (2, 1)
    (root / "scans" / "000001" / "manifest.json").unlink()
    assert main(["scans", "list", "--root", str(root)]) == 0
    assert "DAMAGED" in capsys.readouterr().out


def test_show_prints_the_manifest(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "show", "1", "--root", str(root)]) == 0
    lines = dict(line.split(None, 1) for line in capsys.readouterr().out.splitlines())
    assert lines["manifest.record.water.index"] == "1.3347"
    assert lines["manifest.record.temperatures_c.case"] == "-"
    assert main(["scans", "show", "000001", "--json", "--root", str(root)]) == 0
    assert json.loads(capsys.readouterr().out)["manifest"]["record"]["rig_hash"] == "ab" * 32


def test_show_says_what_to_look_at_ashore_of_a_fault_inside_of_the_housing(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It stood in the journal alone, which stays on the instrument."""
    verdicts = (
        Verdict("identity", False, {}, "PROJECTOR_DARK: all is dark"),
        Verdict("causes", False, {"too_bright_percent": 7.0}),
    )
    Library(root).begin(frames(4), record(), ORIGIN).reject("dark", record(verdicts=verdicts))
    folder = str(root / "rejected" / "000004")
    assert main(["scans", "show", folder]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ashore.")]
    assert [line.split(None, 1) for line in lines] == [["ashore.PROJECTOR_DARK", ASHORE[FaultCode.PROJECTOR_DARK]]]
    assert main(["scans", "show", folder, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ashore"] == {"PROJECTOR_DARK": ASHORE[FaultCode.PROJECTOR_DARK]}


def test_an_unknown_scan_is_one_line_with_a_remedy(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "show", "99", "--root", str(root)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "'99'" in error
    assert "scans list" in error
    assert main(["scans", "show", "99", "--json", "--root", str(root)]) == 1
    assert "'99'" in json.loads(capsys.readouterr().err)["error"]


def test_a_root_that_is_not_there_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "list", "--root", str(tmp_path / "none")]) == 2
    assert "--root" in capsys.readouterr().err


def test_an_empty_root_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scans", "list", "--root", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"no scans under {tmp_path}\n"


def test_a_reader_that_goes_away_is_no_error(root: Path) -> None:
    command = f"{sys.executable} -m appliance.cli scans show 1 --root {root} | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr
