"""`kingfisher calibration measure`: from a stored scan to the response the patterns are drawn for, and to the cameras' noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.measure.calibration.response_file import RESPONSE
from appliance.measure.light.sides import of_side
from appliance.store.config import load_rig, rig_text
from appliance.store.instrument import NOISE_FILE, Instrument
from appliance.store.scan import ScanOrigin
from hw_sim.outside import draw_outside
from hw_sim.scene import Imaging, Scene
from tests.support.commands import Shell
from tests.support.rendered import RenderedScan, render_scan
from tests.support.stored import origin_of, store

RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"


@pytest.fixture(scope="module")
def plane() -> RenderedScan:
    return render_scan(Scene(object="plane", imaging=Imaging("measured")), "modelled", 3, 400, 64)


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


def test_the_file_lies_where_the_instrument_looks_and_is_never_replaced(
    plane: RenderedScan, tmp_path: Path, shell: Shell
) -> None:
    words, of_gone = ("--rig", RIG, "--root", tmp_path), store(plane, tmp_path / "gone", response_hash="cd" * 32)
    said = shell("calibration", "measure", "response", of_gone, *words, "--install")
    assert (said.code, "patterns for another response" in said.err) == (1, True)
    assert not (tmp_path / "calibration").exists()
    scan = store(plane, tmp_path / "plane")
    report = shell("calibration", "measure", "response", scan, *words, "--install", "--json").document
    path = tmp_path / "calibration" / "response.json"
    stored = RESPONSE.load(path)
    assert stored is not None
    assert stored is not None
    assert (report["file"], report["hash"], stored.made_from) == (str(path), stored.response.hash, ("plane",))
    assert report["harmonics_percent"][1] == pytest.approx(-3.5, abs=0.3), "the third, of which the phase knows"
    said = shell("calibration", "measure", "response", scan, *words, "--install")
    assert (said.code, "never replaced" in said.err) == (2, True)
    assert shell("calibration", "measure", "response", scan, *words, "--out", tmp_path / "other.json").code == 0


def test_installed_noise_is_what_the_instrument_expects_from_then_on(
    plane: RenderedScan, tmp_path: Path, shell: Shell
) -> None:
    root, scan, rig = tmp_path / "root", store(plane, tmp_path / "plane"), load_rig(RIG)
    rig, its_own = replace(rig, storage=replace(rig.storage, root=root)), tmp_path / "rig.toml"
    its_own.write_text(rig_text(rig))
    for words in (("--rig", RIG, "--root", root), ("--rig", its_own)):
        said = shell("calibration", "measure", "noise", scan, "--install", *words)
        assert (said.code, f"--root {root}: no such folder" in said.err, root.exists()) == (2, True, False)
    root.mkdir()
    said = shell("calibration", "measure", "noise", scan, "--rig", its_own)
    assert (said.code, said.out.split()[:3]) == (0, ["left", "right", "light_dn"])
    assert not (root / NOISE_FILE).exists(), "only on demand"
    report = shell("calibration", "measure", "noise", scan, "--install", "--rig", its_own, "--json").document
    used = Instrument(rig).with_measured_noise()
    assert used.camera.left.full_well_e == report["left"]["full_well_e"] != rig.camera.left.full_well_e
    for side in ("left", "right"):
        one = report[side]
        assert one["electrons_at_255"] == one["full_well_e"] == pytest.approx(13_000, rel=0.1), "at 0 dB"
        assert one["expected_electrons_at_255"] == pytest.approx(13_000)
        assert one["pixels"] > 40_000
        assert one["noise_dn"] == pytest.approx(one["expected_dn"], rel=0.05)
        expected_dn2 = of_side(Instrument(used).noise(), side).variance_dn2(one["light_dn"])
        assert expected_dn2 == pytest.approx(one["noise_dn"] ** 2)
    kept = (root / NOISE_FILE).read_bytes()
    said = shell("calibration", "measure", "noise", scan, "--install", "--rig", its_own)
    assert (said.code, "the cameras' noise is never replaced; move it away" in said.err) == (2, True)
    assert (root / NOISE_FILE).read_bytes() == kept
    assert shell("calibration", "measure", "noise", scan, "--rig", its_own).code == 0, "it may always be looked at"


def test_the_exposures_that_leave_fringes_straight_are_told_from_scans_at_each(
    plane: RenderedScan, tmp_path: Path, shell: Shell
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
    said = shell("calibration", "measure", "exposures", *scans, "--json").document
    assert (said["exposures_ms"], said["trigger_delay_us"]) == ([12.0, 16.0], 500)
    assert [(one["scan"], one["exposure_ms"], one["gain_db"], one["straight"]) for one in said["scans"]] == [
        ("short", 3.2, 0.0, False), ("plane", 12.0, 0.0, True), ("whole", 16.0, 2.0, True)
    ]  # fmt: skip
    of_short, of_plane, of_whole = said["scans"]
    assert of_short["noisier"] > 1.1 > 1.05 > of_whole["noisier"] >= 1.0
    # The ordinary projector: its third harmonic, 3.5 % of the first, is an amplitude of 0.36 px of 64.
    assert of_plane["bend_px"] == pytest.approx(0.36 / 2.0**0.5, rel=0.1)
    # Its slope is 8π/64 times as large, s = 0.14, and noise grows by the root of 1 + 3/2 s².
    assert of_plane["noisier"] == pytest.approx((1.0 + 1.5 * 0.1414**2) ** 0.5, abs=0.002)
    assert 0.005 < of_whole["noise_px"] < 0.1
    # An exposure is as good as its worst scan, in whatever order they are given.
    again = store(whole, tmp_path / "again", exposure_ms=3.2, origin=origin)
    for both in ((scans[0], again), (again, scans[0])):
        worst = shell("calibration", "measure", "exposures", *both, "--json")
        assert (worst.code, worst.document["exposures_ms"]) == (1, [])
    shown = shell("calibration", "measure", "exposures", scans[0], scans[2]).out
    assert "exposures_ms = [12.0]" in shown
    assert " ".join(shown.splitlines()[0].split()) == "SCAN EXPOSURE MS GAIN DB BEND PX NOISE PX NOISIER STRAIGHT"


def test_exposures_are_not_told_from_a_dark_scan_or_from_scans_that_begin_at_other_moments(
    plane: RenderedScan, tmp_path: Path, shell: Shell
) -> None:
    dark = replace(plane, frames={side: np.minimum(frames, 9) for side, frames in plane.frames.items()})
    said = shell("calibration", "measure", "exposures", store(dark, tmp_path / "dark", exposure_ms=12.0))
    assert (said.code, "too few points" in said.err) == (1, True)
    rig, scans = load_rig(RIG), list[Path]()
    for delay_us in (700, 500):
        other = rig_text(replace(rig, board=replace(rig.board, trigger_delay_us=delay_us))).encode()
        scans.append(store(plane, tmp_path / str(delay_us), exposure_ms=12.0, origin=ScanOrigin(b"{}", other)))
    said = shell("calibration", "measure", "exposures", *scans)
    assert (said.code, "500 and 700 us" in said.err) == (1, True)
