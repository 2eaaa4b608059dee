"""Watches over many scans: over the calibration in use, whose alarms belong to it, and over windows that fog."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibrate.third_eye import FITTED_SCANS
from appliance.instrument.machine import events as on
from appliance.instrument.machine.alerts import alert_of
from appliance.instrument.service.watches import CalibrationWatch, WindowWatch
from appliance.measure.calibration.file import Calibration
from appliance.measure.fault import FaultCode
from appliance.measure.light.sides import SIDES
from appliance.measure.verdicts.window import CELLS, Windows
from hw_sim.mount_shift import MountShift, with_mount_shifted
from tests.support.gap_scans import calibrated, scan
from tests.support.golden_texts import Says
from tests.support.truth import WATER

N = CELLS[0] * CELLS[1]


def looked(fall: float, light_dn: float, cell: int = 0, forgiven: float = 0.0, whole: float | None = None) -> Windows:
    """The left window with a fall in one cell, before a scene of one brightness."""
    falls = {side: np.zeros(N) for side in SIDES}
    falls["left"][cell] = fall
    light = {side: np.full(N, light_dn) for side in SIDES}
    return Windows(falls, {"left": whole, "right": None}, {"left": forgiven, "right": 0.0}, light)


def passed(watch: WindowWatch, *falls: float, forgiven: float = 0.0) -> list[bool | None]:
    return [watch.judge(looked(fall, 100.0 + 50.0 * (k % 2), forgiven=forgiven)).passed for k, fall in enumerate(falls)]


@pytest.mark.parametrize(
    ("falls", "forgiven", "expected"),
    [
        ((1.0, 1.0, 1.0), 0.0, [True, True, False]),
        *(((fall,) * 3, forgiven, [True, True, good]) for fall, forgiven, good in (
            (0.094, 0.0, False), (0.093, 0.0, True), (0.194, 0.1, False), (0.193, 0.1, True))),
        ((-1.0, 1.0, 1.0, 1.0), 0.0, [True, True, True, False]), ((1.0, 1.0, np.nan, 1.0), 0.0, [True, True, True, False]),
    ],
)  # fmt: skip
def test_an_alarm_needs_three_scans_and_what_exceeds_the_forgiven(
    falls: tuple[float, ...], forgiven: float, expected: list[bool]
) -> None:
    assert passed(WindowWatch(), *falls, forgiven=forgiven) == expected


def test_however_long_it_lasted_three_clean_scans_end_an_alarm() -> None:
    ended = passed(WindowWatch(), *[1.0] * 10, *[0.0] * 4, forgiven=0.08)
    assert ended == [True, True, *[False] * 10, True, True]


@pytest.mark.parametrize(
    ("before_dn", "light_dn", "counts"),
    [(100.0, 104.0, False), (100.0, 106.0, True), (100.0, 96.0, False), (100.0, 94.0, True), (0.1, 1.0, False), (0.1, 1.1, True)],
)  # fmt: skip
def test_a_scene_is_another_one_from_a_twentieth_of_its_light_on_unless_it_is_dark(
    before_dn: float, light_dn: float, counts: bool
) -> None:
    watch = WindowWatch()
    watch.judge(looked(0.0, before_dn))
    assert ("not counted" in watch.judge(looked(0.0, light_dn)).text) is not counts


@pytest.mark.parametrize("cell", [CELLS[0] - 1, 3 * CELLS[0] + 4])
def test_the_place_is_named_and_a_scan_counts_once(cell: int, says: Says) -> None:
    watch = WindowWatch()
    for number in range(3):
        seen = looked(1.0, 100.0 + 50.0 * number, cell)
        told = watch.count(number, seen)
        assert watch.count(number, seen) is None
    assert told is not None
    verdict, (left, right) = told
    says(verdict.text)
    assert isinstance(left, on.ConditionRaised)
    assert (left.fault.code, left.fault.device, left.fault.detail) == (FaultCode.WINDOW, "camera.left", verdict.text)
    assert right == on.ConditionCleared(FaultCode.WINDOW, "camera.right")


def test_a_window_that_is_soft_all_over_is_named_as_a_whole(says: Says) -> None:
    watch = WindowWatch()
    verdicts = [watch.judge(looked(0.0, 100.0 + 50.0 * number, whole=1.0)) for number in range(3)]
    assert [one.passed for one in verdicts] == [True, True, False]
    says(verdicts[-1].text)


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


def test_the_projector_is_learnt_over_starts_of_the_instrument_and_finds_a_turn_about_y(tmp_path: Path) -> None:
    rng, turned = np.random.default_rng(4), with_mount_shifted(MADE.truth, MountShift("right", yaw_deg=0.02))
    for number in range(1, FITTED_SCANS + 4):
        watch = CalibrationWatch(tmp_path, CALIBRATION)
        verdict = watch.judge(scan(MADE, MADE.truth if number <= FITTED_SCANS + 1 else turned, rng, pattern=True))
        assert ("even_um" in verdict.numbers) == (number > FITTED_SCANS)
        write = watch.unwritten(f"{number:06d}")
        assert write is not None
        write()
    assert abs(verdict.numbers["even_um"] or 0.0) > 80.0
    assert watch.fault is not None
    assert "about its y axis" in watch.fault.detail


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
