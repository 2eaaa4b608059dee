"""`kingfisher measure`: from a stored scan to the response the patterns are drawn for, and to the cameras' noise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.response.file import load
from appliance.cli import main
from appliance.config import load_rig, rig_text
from appliance.instrument import NOISE_FILE, noise_of, with_measured_noise
from appliance.scan.sides import of_side
from appliance.storage.scan import ScanOrigin
from hw_sim.outside import draw_outside
from hw_sim.scene import Imaging, Scene
from tests.support.rendered import RenderedScan, render_scan
from tests.support.stored import origin_of, store

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


def test_installed_noise_is_what_the_instrument_expects_from_then_on(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    scan, words = store(plane, tmp_path / "plane"), ("--rig", str(RIG), "--root", str(root))
    assert main(["measure", "noise", str(scan), "--install", *words]) == 2, "a root that is mistyped is not made"
    assert f"--root {root}: no such folder" in capsys.readouterr().err
    its_own = tmp_path / "rig.toml"
    its_own.write_text(rig_text(replace(load_rig(RIG), storage=replace(load_rig(RIG).storage, root=root))))
    assert main(["measure", "noise", str(scan), "--install", "--rig", str(its_own)]) == 2, "nor that of a rig file"
    assert f"--root {root}: no such folder; give the instrument's" in capsys.readouterr().err
    assert not root.exists()
    root.mkdir()
    assert main(["measure", "noise", str(scan), *words]) == 0
    shown = capsys.readouterr().out
    assert "installed" not in shown
    assert not (root / NOISE_FILE).exists(), "only on demand"
    assert shown.split()[:3] == ["left", "right", "light_dn"]
    assert main(["measure", "noise", str(scan), "--install", *words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    for side in ("left", "right"):
        assert said[side]["electrons_at_255"] == said[side]["full_well_e"] == pytest.approx(13_000, rel=0.08), "at 0 dB"
        assert said[side]["pixels"] > 40_000
        assert said[side]["noise_dn"] == pytest.approx(said[side]["expected_dn"], rel=0.05)
        assert said[side]["expected_electrons_at_255"] == pytest.approx(13_000)
    rig = load_rig(RIG)
    rig = replace(rig, storage=replace(rig.storage, root=root))
    used = with_measured_noise(rig)
    assert used.camera.left.full_well_e == said["left"]["full_well_e"] != rig.camera.left.full_well_e
    for side in ("left", "right"):
        light_dn = said[side]["light_dn"]
        assert of_side(noise_of(used), side).variance_dn2(light_dn) == pytest.approx(said[side]["noise_dn"] ** 2)
    kept = (root / NOISE_FILE).read_bytes()
    assert main(["measure", "noise", str(scan), "--install", *words]) == 2
    assert "the cameras' noise is never replaced; move it away" in capsys.readouterr().err
    assert (root / NOISE_FILE).read_bytes() == kept
    (root / NOISE_FILE).unlink()
    assert main(["measure", "noise", str(scan), "--install", *words]) == 0
    assert f"installed: {root / NOISE_FILE}" in capsys.readouterr().out
    assert (root / NOISE_FILE).read_bytes() == kept
    assert main(["measure", "noise", str(scan), *words]) == 0, "it may always be looked at"


def test_the_exposures_that_leave_fringes_straight_are_told_from_scans_at_each(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A projector with bit planes: of 3.2 of its 16.7 ms some bits are seen long and others not at all."""
    bits = Scene(object="plane", outside=draw_outside(10_001, ("projector",)))
    short = render_scan(bits, "modelled", 3, 320, 16, exposure_s=0.0032, gain_db=10.0)
    whole = render_scan(bits, "modelled", 3, 320, 16, exposure_s=0.016)
    origin = origin_of(plane.renderer.truth, 400, 300)
    scans = [
        store(short, tmp_path / "short", exposure_ms=3.2, origin=origin),
        store(whole, tmp_path / "whole", exposure_ms=16.0, gain_db=2.0, origin=origin),
        store(plane, tmp_path / "plane", exposure_ms=12.0, origin=origin),
    ]
    assert main(["measure", "exposures", *map(str, scans), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["exposures_ms"], said["trigger_delay_us"]) == ([12.0, 16.0], 500)
    by_scan = {one["scan"]: one for one in said["scans"]}
    assert by_scan["short"]["noisier"] > 1.1 > 1.05 > by_scan["whole"]["noisier"] >= 1.0
    # The ordinary projector: its third harmonic, 3.5 % of the first, is an amplitude of 0.36 px of 64.
    assert by_scan["plane"]["bend_px"] == pytest.approx(0.36 / 2.0**0.5, rel=0.1)
    # Its slope is 8π/64 times as large, s = 0.14, and noise grows by the root of 1 + 3/2 s².
    assert by_scan["plane"]["noisier"] == pytest.approx((1.0 + 1.5 * 0.1414**2) ** 0.5, abs=0.002)
    assert [one["scan"] for one in said["scans"]] == ["short", "plane", "whole"], "in the order of their exposures"
    assert [(one["exposure_ms"], one["gain_db"], one["straight"]) for one in said["scans"]] == [
        (3.2, 0.0, False), (12.0, 0.0, True), (16.0, 2.0, True)
    ]  # fmt: skip
    assert 0.005 < by_scan["whole"]["noise_px"] < 0.1
    # An exposure is as good as its worst scan, in whatever order they are given.
    again = store(whole, tmp_path / "again", exposure_ms=3.2, origin=origin)
    for both in ((scans[0], again), (again, scans[0])):
        assert main(["measure", "exposures", *map(str, both), "--json"]) == 1
        assert json.loads(capsys.readouterr().out)["exposures_ms"] == []
    assert main(["measure", "exposures", str(scans[0]), str(scans[2])]) == 0
    shown = capsys.readouterr().out
    assert "exposures_ms = [12.0]" in shown
    head, first, second, *_ = (line.split() for line in shown.splitlines())
    assert " ".join(head) == "SCAN EXPOSURE MS GAIN DB BEND PX NOISE PX NOISIER STRAIGHT"
    assert (first[0], first[1], first[-1], second[0], second[-1]) == ("short", "3.2", "no", "plane", "yes")


def test_exposures_are_not_told_from_a_dark_scan_or_from_scans_that_begin_at_other_moments(
    plane: RenderedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dark = replace(plane, frames={side: np.minimum(frames, 9) for side, frames in plane.frames.items()})
    assert main(["measure", "exposures", str(store(dark, tmp_path / "dark", exposure_ms=12.0))]) == 1
    assert "too few points" in capsys.readouterr().err
    rig, scans = load_rig(RIG), list[str]()
    for delay_us in (700, 500):
        other = rig_text(replace(rig, board=replace(rig.board, trigger_delay_us=delay_us))).encode()
        scans.append(str(store(plane, tmp_path / str(delay_us), exposure_ms=12.0, origin=ScanOrigin(b"{}", other))))
    assert main(["measure", "exposures", *scans]) == 1
    assert "500 and 700 us" in capsys.readouterr().err
