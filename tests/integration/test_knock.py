"""A dive in which a camera is knocked: the next scan says so, is kept all the same, and a restart has not forgotten it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.calibration.file import encode, load
from appliance.cli.main import main
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.instrument import CALIBRATION_FILE
from appliance.service.app import run
from appliance.storage.library import Library
from hw_sim.options import options_from
from hw_sim.truth import draw_truth
from tests.support.truth import true_calibration

SCAN = """
press scan
wait state REVIEW 90
pause 1
"""
KEEP = """
press scan
wait state AIM 90
pause 0.5
"""
DIVE = f"""
wait state AIM 90
{SCAN}{KEEP}
object shell
{SCAN}{KEEP}
knock right pitch_deg=0.03
{SCAN}
wait alert VERIFY_CALIBRATION 20
{KEEP}
end
"""
NEXT_DAY = """
wait state AIM 90
wait alert VERIFY_CALIBRATION 5
end
"""


def dive(root: Path, script: str) -> Rig:
    """The small instrument, perfectly calibrated on the day before."""
    path = root.with_suffix(".script")
    path.write_text(script)
    options = SimOptions(root=root, object_name="pipe", truth="modelled", seed=11, size="400x300", script=path)
    rig = simulated(load_rig(default_sim_rig()), options)
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = rig.storage.root / CALIBRATION_FILE
    calibration.parent.mkdir(parents=True, exist_ok=True)
    calibration.write_bytes(encode(true_calibration(truth, rig.rig.serial)))
    return rig


@pytest.mark.dive
def test_a_knock_between_scans(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "dive"
    assert run(dive(root, DIVE)) == 0
    library = Library(root)
    verdicts = []
    for entry in library.entries():
        assert entry.manifest is not None
        assert entry.ok
        (verdict,) = (v for v in entry.manifest.record.verdicts if v.name == "ray-gaps")
        verdicts.append(verdict)
    assert [verdict.passed for verdict in verdicts] == [True, True, False]
    assert "right camera turned by +0.03" in verdicts[-1].text
    assert verdicts[-1].numbers["height_um"] == pytest.approx(-280.0, abs=15.0)
    assert abs(verdicts[0].numbers["height_um"] or 1e9) < 2.0

    assert main(["scans", "show", "3", "--root", str(root)]) == 0
    shown = capsys.readouterr().out
    assert "verdicts.ray-gaps.passed" in shown
    assert "verdicts.ray-gaps.numbers.height_sigma_um" in shown

    assert run(dive(root, NEXT_DAY)) == 0, "the script waits for the alert"
    status = json.loads((root / "run" / "status.json").read_text())
    assert [alert["headline"] for alert in status["alerts"]] == ["VERIFY CALIBR."]

    # At the desk: the trend, and what is no answer to it.
    assert main(["health", "show", "--root", str(root)]) == 0
    shown = capsys.readouterr().out
    assert "3 scans judged" in shown
    assert shown.count("ALARM") == 1
    assert accepted(root, "other") == 2
    assert "evaluate with the one in use" in capsys.readouterr().err
    assert accepted(root, "bad", e_l_percent=0.3) == 2
    assert "0.300 %; allowed are up to 0.1 %" in capsys.readouterr().err
    assert accepted(root, "old", scan="000002") == 2
    assert "before the alarm of scan 000003" in capsys.readouterr().err
    assert alarm(root, capsys) is not None
    assert accepted(root, "good") == 0
    assert alarm(root, capsys) is None
    assert accepted(root, "good") == 2, "there is nothing to accept any more"


def accepted(root: Path, kind: str, e_l_percent: float = 0.02, scan: str = "000003") -> int:
    """What `health accept` says to a report of an evaluation."""
    used = "0" * 64 if kind == "other" else load(root / CALIBRATION_FILE).hash
    report = root.parent / f"{kind}.json"
    content = {
        "about": {"calibration": used},
        "complete": True,
        "summary": {"e_l_ball_bar_percent": e_l_percent},
        "scans": [{"scan": scan, "artefact": "ball-bar"}],
    }
    report.write_text(json.dumps(content))
    return main(["health", "accept", str(report), "--root", str(root)])


def alarm(root: Path, capsys: pytest.CaptureFixture[str]) -> str | None:
    capsys.readouterr()
    assert main(["health", "show", "--json", "--root", str(root)]) == 0
    said = json.loads(capsys.readouterr().out)["alarm"]
    return None if said is None else str(said)
