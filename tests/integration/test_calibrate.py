"""A whole calibration in water on a hidden rig: from the calibration in air to the result, over a loss of power, and back."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.calibrate.air.calibrate import AirCalibration
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import Step
from appliance.calibrate.water.start import start_from_air
from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.measure.calibration.file import Calibration, encode_calibration
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.library import Library
from hw_sim.scene import Scene
from tests.integration.dived import Service, ball_bar_mm
from tests.support.calibrating import WIDTH_PX, air_of, hidden_rig
from tests.support.rendered import render_scan

SEED, SIZE = 2, "800x600"
UNTIL_THE_POWER_FAILS = """
wait state AIM 90
press back            # UNCALIBRATED: seen
press up                    # the menu
press down
press down
press down
press scan
wait step M1 10
object pipe
press scan
wait result NOT_FOUND 90
object ballbar -15 -20 505 0 35 20
press scan
wait step M2 90
object ballbar 15 20 540 0 -35 70
press scan
wait step M3 90
object plane 0 0 478 8 -10 0
press scan
pause 600
"""
AFTERWARDS = """
wait state AIM 90
press up                    # the menu
press down
press down
press down
press scan
wait step M3 10
object plane 0 0 478 8 -10 0
press scan
wait step M4 90
object plane 0 0 570 -10 8 0
press scan
wait step SOLVE 90
press scan
wait step VERIFY 300
object ballbar 0 0 520 0 5 -40
press scan
wait step RESULT 90
press scan                  # KEEP
wait step RESULT 90
press back
wait state AIM 10
pause 2
press scan                  # an ordinary scan, with the new calibration
wait state REVIEW 90
pause 2
press scan
wait state AIM 90
pause 3
press up                    # the result is still there
press down
press down
press down
press scan
wait step RESULT 10
press scan                  # RESTORE
wait step RESULT 90
pause 1
press back
wait state AIM 10
pause 0.5
end
"""
UNSEEN = ((0.0, 5.0, 500.0, 0.0, 20.0, 0.0), (-10.0, 0.0, 545.0, 0.0, -15.0, 85.0))


def binned(camera: HousedCamera, factor: float) -> HousedCamera:
    """The same camera with larger pixels."""
    lens = camera.lens
    f = lens.f_px[0] / factor, lens.f_px[1] / factor
    c = (lens.c_px[0] + 0.5) / factor - 0.5, (lens.c_px[1] + 0.5) / factor - 0.5
    size = int(camera.width_px / factor), int(camera.height_px / factor)
    return replace(camera, width_px=size[0], height_px=size[1], lens=replace(lens, f_px=f, c_px=c))


def calibration_in_air(rig: Rig) -> Calibration:
    """As from twenty boards before the whole cameras, for the rig's larger pixels."""
    factor = WIDTH_PX / rig.camera.left.width_px
    air = air_of(hidden_rig("realistic", SEED))
    scale = np.ones(22)
    scale[[0, 1, 2, 8, 9, 10]] = 1.0 / factor
    smaller = replace(
        air,
        rig=StereoRig(binned(air.rig.left, factor), binned(air.rig.right, factor)),
        covariance=air.covariance * np.outer(scale, scale),
    )
    assert isinstance(smaller, AirCalibration)
    return start_from_air(smaller, Instrument(rig).design())


def dive(rig: Rig, folder: Path, script: str) -> Service:
    """Start the service in a process of its own, with a diver who follows ``script``."""
    path = folder / "dive.script"
    path.write_text(script)
    words = f"size={SIZE} object=ballbar texture=none truth=realistic seed={SEED} --script"
    return Service(rig.storage.root, *words.split(), str(path))


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_a_hidden_rig_is_calibrated_over_a_loss_of_power_and_the_old_file_comes_back(tmp_path: Path) -> None:
    options = SimOptions(
        root=tmp_path / "dive", object_name="ballbar", texture="none", truth="realistic", seed=SEED, size=SIZE
    )
    rig = apply_options(load_rig(default_sim_rig()), options)
    store, library = Calibrations(rig.storage.root, rig.rig.serial), Library(rig.storage.root)
    in_air = calibration_in_air(rig)
    store.folder.mkdir(parents=True)
    store.air.write_bytes(encode_calibration(in_air))
    old = encode_calibration(replace(in_air, method="bundle, an older one", air_covariance=None)) + b"\n"
    store.current.write_bytes(old)

    first = dive(rig, tmp_path, UNTIL_THE_POWER_FAILS)
    deadline = time.monotonic() + 600.0
    while True:  # the power fails while the third recording, whose frames are stored, is being examined
        at: dict[str, Any] = first.status().get("calibration") or {}
        assert first.process.poll() is None, "the service ended by itself"
        assert time.monotonic() < deadline
        if at.get("step") == "M3" and at["busy"] and list((rig.storage.root / "scans").glob(".0*/m*")):
            break
        time.sleep(0.02)
    os.kill(first.process.pid, signal.SIGKILL)
    first.process.wait(10.0)
    assert [check.step for check in store.session().trials] == [Step.M1, Step.M2]

    second = dive(rig, tmp_path, AFTERWARDS)
    in_use: list[bool] = []
    while second.process.poll() is None:
        at = second.status().get("calibration") or {}
        if at and at["in_use"] not in in_use[-1:]:
            in_use.append(at["in_use"])
        assert time.monotonic() < deadline + 600.0
        time.sleep(0.02)
    assert (second.process.returncode, in_use) == (0, [False, True, False])

    session = store.session()
    assert session.solved is not None
    assert session.verified is not None
    assert session.kept is not None
    assert session.solved.method == "bundle, spline"
    before, after = session.verified.before, session.verified.after
    assert abs(after or 1.0) < min(0.0005, abs(before or 0.0) / 3.0)
    assert store.current.read_bytes() == (store.folder / "kept" / session.kept).read_bytes() == old

    ordinary = library.entries()[-1].manifest
    assert ordinary is not None
    assert ordinary.record.calibration_hash == session.solved.calibration_hash
    assert (ordinary.record.cloud["points"] or 0.0) > 2000
    assert (ordinary.record.cloud["gap_mm"] or 1.0) < 0.03, "rays meet"

    # Against the truth, which no certificate states, at poses that nobody recorded.
    truth_mm = hidden_rig("realistic", SEED).artefacts.ball_distance_mm
    scans = [
        render_scan(Scene(object="ballbar", pose=pose, texture="none"), "realistic", SEED, 800, 16) for pose in UNSEEN
    ]
    of_old, of_new = (
        max(abs(ball_bar_mm(calibration, scan.sequence, scan.frames) / truth_mm - 1.0) for scan in scans)
        for calibration in (load_calibration(store.current), load_calibration(store.solved))
    )
    assert of_new < min(0.0006, of_old / 3.0)
