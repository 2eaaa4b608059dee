"""The watch over the calibration in use: alarms belong to a calibration, and one that nobody measured has no trend."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from appliance.calibration.file import Calibration
from appliance.machine.alerts import alert_of
from appliance.scan.fault import FaultCode
from appliance.service.health import CalibrationWatch
from hw_sim.mount_shift import MountShift, with_mount_shifted
from tests.support.gap_scans import calibrated, scan
from tests.support.truth import WATER

MADE = calibrated(1)
CALIBRATION = Calibration("KF-0001", "bundle, spline", "2026-01-01", ("a test",), WATER, MADE.rig, 0.05)


def watched(root: Path) -> CalibrationWatch:
    """After two normal scans and one of a knocked instrument, all written down."""
    watch = CalibrationWatch(root, CALIBRATION)
    rng = np.random.default_rng(1)
    turned = with_mount_shifted(MADE.truth, MountShift("right", pitch_deg=0.03))
    for number, truth in enumerate((MADE.truth, MADE.truth, turned), 1):
        verdict = watch.judge(scan(MADE, truth, rng))
        assert verdict.passed is (number < 3)
        write = watch.unwritten(f"{number:06d}")
        assert write is not None
        write()
        assert watch.unwritten("again") is None
    return watch


def test_an_alarm_belongs_to_its_calibration(tmp_path: Path) -> None:
    watch = watched(tmp_path)
    found = watch.fault
    assert found is not None
    assert found.code is FaultCode.VERIFY_CALIBRATION
    assert "right camera turned by +0.03" in found.detail
    shown = alert_of(found)
    assert (shown.headline, shown.action) == ("VERIFY CALIBR.", "CHECK WATER AND BALL BAR")

    watch.use(replace(CALIBRATION, made_at="2026-02-01"))
    of_another = watch.fault
    assert of_another is None, "a new calibration begins with a clean slate"
    watch.use(CALIBRATION)
    assert watch.fault == found, "the old one comes back with what was found"
    again = CalibrationWatch(tmp_path, CALIBRATION)
    assert again.fault == watch.fault
    assert [point.scan for point in again.trend.points] == ["000001", "000002", "000003"]


def test_a_length_check_takes_the_alarm_back_for_good(tmp_path: Path) -> None:
    watch = watched(tmp_path)
    write = watch.answer("the bar is right")
    assert write is not None
    write()
    assert watch.answer("again") is None, "there is no alarm any more"
    turned = with_mount_shifted(MADE.truth, MountShift("right", pitch_deg=0.03))
    further = with_mount_shifted(MADE.truth, MountShift("right", pitch_deg=0.07))
    for still in (watch, CalibrationWatch(tmp_path, CALIBRATION)):
        assert still.fault is None
        assert [answer.partition(", after: ")[0] for answer in still.trend.answers] == ["the bar is right"]
        assert still.judge(scan(MADE, turned, np.random.default_rng(2))).passed is True, (
            "what the gaps show now is normal"
        )
        assert still.judge(scan(MADE, further, np.random.default_rng(3))).passed is False, "and a second knock is none"
