"""`kingfisher measure`: from a stored scan to the response the patterns are drawn for, and to the cameras' noise."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.calibration.response.file import load
from appliance.cli import main
from hw_sim.scene import Imaging, Scene
from tests.support.rendered import RenderedScan, render_scan
from tests.support.stored import store

RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"


@pytest.fixture(scope="module")
def plane() -> RenderedScan:
    return render_scan(Scene(object="plane", imaging=Imaging("measured")), "modelled", 3, 400, 64)


def measure(root: Path, *words: object) -> int:
    return main(["measure", "response", *map(str, words), "--rig", str(RIG), "--root", str(root)])


def test_the_file_lies_where_the_instrument_looks_and_is_never_replaced(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = store(plane, tmp_path / "plane")
    assert measure(tmp_path, scan, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    path = tmp_path / "calibration" / "response.json"
    stored = load(path)
    assert stored is not None
    assert (said["file"], said["hash"]) == (str(path), stored.response.hash)
    assert stored.made_from == ("plane",)
    assert said["harmonics_percent"][1] == pytest.approx(-3.5, abs=0.3), "the third, of which the phase knows"
    assert measure(tmp_path, scan) == 2
    assert "never replaced" in capsys.readouterr().err
    assert measure(tmp_path, scan, "--out", tmp_path / "other.json") == 0


def test_a_scan_drawn_for_a_response_that_is_gone_is_refused(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = store(plane, tmp_path / "plane", response_hash="cd" * 32)
    assert measure(tmp_path, scan) == 1
    assert "drawn for another response" in capsys.readouterr().err
    assert not (tmp_path / "calibration").exists()


def test_the_noise_in_a_scan_is_shown_beside_the_data_sheets(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = store(plane, tmp_path / "plane")
    assert main(["measure", "noise", str(scan), "--rig", str(RIG), "--root", str(tmp_path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    for side in ("left", "right"):
        assert said[side]["noise_dn"] == pytest.approx(said[side]["expected_dn"], rel=0.05)
        assert said[side]["expected_electrons_at_255"] == pytest.approx(13_000)
