"""The ladder's measurement is honest: unseen poses, all errors counted, tables that say what the files say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bench.bench_metrology import main, measure
from bench.metrology.accuracy import BEGIN, END, write_accuracy
from bench.metrology.hidden import Effort, examine
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES, unseen
from bench.metrology.rungs import needed
from bench.metrology.table import JsonRow, as_json, summary, text
from tests.support.calibrating import hidden_rig

SMALL = Effort(rungs=("pm_mapped", "ba_spline_4"), boards=8, bars=1, planes=1, frustums=1)


def row(rung: str, seed: int, e_lb: float | None, missing: tuple[str, ...] = ()) -> JsonRow:
    return {
        "rung": rung,
        "seed": seed,
        "E_Lb": e_lb,
        "E_Lp": 0.2,
        "E_F": 0.1,
        "E_F_sys": 0.02,
        "noise_mm": 0.02,
        "gap_mm": 0.01,
        "recordings": 4,
        "seconds": 1.0,
        "missing": list(missing),
    }


@pytest.mark.dive
def test_from_wires_to_numbers_a_bundle_beats_a_pinhole() -> None:
    done: list[str] = []
    rows = {r.rung: as_json(r) for r in examine("realistic", 3, 800, 600, SMALL, done.append)}
    assert len(done) == SMALL.scans == 7
    pinhole, bundle = rows["pm_mapped"], rows["ba_spline_4"]
    assert (pinhole["recordings"], bundle["recordings"]) == (0, 4)
    assert not pinhole["missing"]
    assert not bundle["missing"]
    assert bundle["E_Lb"] < 0.06
    assert bundle["E_Lp"] < min(0.10, 0.5 * pinhole["E_Lp"])
    assert bundle["E_F_sys"] < 0.03
    assert bundle["gap_mm"] < 0.02 < 0.1 < pinhole["gap_mm"], (
        "rays of a pinhole pass by each other, and are still judged"
    )
    assert 0.01 < bundle["noise_mm"] < 0.03


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_small_measurement_keeps_its_bounds() -> None:
    assert all(number.kept for number in measure())


@pytest.mark.long
@pytest.mark.timeout(900)
def test_salt_water_spoils_lengths_unless_the_index_is_updated(tmp_path: Path) -> None:
    out = tmp_path / "run.json"
    options = "--set realistic --seed 2 --resolution 800x600 --rungs ba_spline_10 --bars 1 --planes 1 --frustums 1"
    assert main([*options.split(), "--json", str(out)]) == 0
    run = json.loads(out.read_text())
    rows = {r["rung"]: r for r in run["rows"]}
    assert rows["salt_updated"]["E_Lb"] < 0.04
    assert 0.4 < rows["salt_not_updated"]["E_Lb"] < 0.6
    assert run["summary"]["salt_updated"]["E_Lb"]["worst"] == rows["salt_updated"]["E_Lb"]


@pytest.mark.parametrize("truth_set", ["realistic", "paper"])
def test_unseen_poses_are_the_same_each_time_and_none_calibrates(truth_set: str) -> None:
    truth = hidden_rig(truth_set, 5)
    found = unseen(truth, 4, 3, 3)
    assert found == unseen(truth, 4, 3, 3)
    assert [name for name, _ in found] == ["ballbar"] * 4 + ["plane"] * 3 + ["frustum"] * 3
    for name, used in (("ballbar", CALIBRATION_BARS), ("plane", CALIBRATION_PLANES)):
        for pose in (pose for thing, pose in found if thing == name):
            assert min(np.abs(np.subtract(pose, other)).max() for other in used) > 3.0


def test_only_what_a_rung_asks_for_is_recorded() -> None:
    assert needed(["pm_mapped"]) == ()
    assert needed(["rm", "ba_ports"]) == ("bar 0", "bar 1", "plane 0", "plane 1")
    assert len(needed(["ba_ports", "ba_spline_10"])) == 10


def test_median_and_worst_are_over_rigs_and_what_was_not_found_is_counted() -> None:
    rows = [row("rm", 1, 0.1), row("rm", 2, 0.4), row("rm", 3, 0.2), row("pm_mapped", 1, None, ("ball-bar: no ball",))]
    summed = summary(rows)
    assert summed["rm"]["E_Lb"] == {"median": 0.2, "worst": 0.4}
    assert summed["rm"]["rigs"] == 3
    assert summed["pm_mapped"]["E_Lb"] is None
    assert summed["pm_mapped"]["missing"] == 1
    shown = text({"set": "paper"}, rows)
    assert "1 not found" in shown
    assert any(line.split() == ["RM", "E_Lb", "0.40", "0.200", "0.400"] for line in shown.splitlines())


def file_of_run(folder: Path, tag: str, rows: list[JsonRow], resolution: str = "1600x1200") -> None:
    unseen_scans = {"bars": 4, "planes": 3, "frustums": 3}
    run = {"set": "realistic", "resolution": resolution, "unseen": unseen_scans, "rows": rows}
    (folder / f"metrology-realistic{tag}.json").write_text(json.dumps(run))


def test_the_document_says_what_the_files_say(tmp_path: Path) -> None:
    file_of_run(tmp_path, "", [row("ba_spline_4", 1, 0.02), row("rm", 1, 0.1)])
    file_of_run(tmp_path, "-more", [row("ba_spline_4", 2, 0.09), row("rm", 2, 0.3)])
    document, picture = tmp_path / "accuracy.md", tmp_path / "accuracy.png"
    document.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_accuracy(tmp_path, document, picture)
    written = document.read_text()
    assert written.startswith("before\n")
    assert written.endswith("\nafter\n")
    assert "old" not in written
    assert "2 rigs (seed 1, 2)" in written
    assert "0.055 (0.090) ≤ 0.05 **missed**" in written
    assert "0.200 (0.300)" in written
    assert picture.stat().st_size > 1000


def test_files_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    document = tmp_path / "accuracy.md"
    document.write_text(f"{BEGIN}\n{END}\n")
    file_of_run(tmp_path, "", [row("rm", 1, 0.1)])
    file_of_run(tmp_path, "-again", [row("rm", 1, 0.1)])
    with pytest.raises(ValueError, match="rig 1 of set realistic is in two files"):
        write_accuracy(tmp_path, document, tmp_path / "accuracy.png")
    file_of_run(tmp_path, "-again", [row("rm", 2, 0.1)], "800x600")
    with pytest.raises(ValueError, match="made otherwise"):
        write_accuracy(tmp_path, document, tmp_path / "accuracy.png")
    assert document.read_text() == f"{BEGIN}\n{END}\n"


@pytest.mark.parametrize("options", ["--resolution 800x800", "--rungs rm,gold", "--rigs 0", "--seed -1"])
def test_wrong_options_are_named(options: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(options.split())
    assert ended.value.code == 2
    assert f"{options.split()[0]}" in capsys.readouterr().err
