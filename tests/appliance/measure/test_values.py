"""Small values of a scan: noise after EMVA 1288, faults as verdicts, guidance, exposures and their light, and the one word for a scan."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest

from appliance.instrument.machine.alerts import RULES, Severity
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import LOST, UNKNOWN, Guidance, Move, Overlap
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import NOMINAL, Exposure, Span, ladder
from appliance.measure.light.noise import MAD_TO_SIGMA, TYPICAL, CameraNoise, StereoNoise, camera_noise
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.verdict import HARMLESS_FAULTS, SPOILS_POINTS, Grade, Verdict, grade, is_usable
from appliance.store.config.load import load_rig

CAMERA = CameraNoise(read_dn=0.9, dn_per_e=0.05, black_dn=3.0)


def test_of_what_nothing_is_said_the_shipped_rig_file_holds() -> None:
    rig, usual = load_rig(), AcquisitionSettings()
    camera = rig.camera.left
    assert usual.frame_s == pytest.approx(1.0 / rig.projector.refresh_hz)
    assert usual.exposure == Exposure(round(1000.0 * camera.exposure_ms), camera.gain_db)
    assert usual.steps == (usual.exposure,), "and none but its own exposure may be proposed"
    assert camera_noise(camera.full_well_e, camera.read_noise_e, camera.black_level_dn, 0.0) == TYPICAL


def test_an_image_scatters_as_each_of_its_grey_values() -> None:
    grey_dn = np.array([[0.0, 3.0], [4.0, 255.0]])
    variance = CAMERA.variance_dn2(grey_dn)
    assert variance.tolist() == [[CAMERA.variance_dn2(float(v)) for v in row] for row in grey_dn]
    assert variance[0, 0] == variance[0, 1] == pytest.approx(0.81), "below black there is no light to be missing"
    assert variance[1, 1] == pytest.approx(0.81 + 0.05 * 252.0)
    assert CAMERA.dark_variance_dn2 + 0.05 * 200.0 == pytest.approx(CAMERA.variance_dn2(200.0)), "as kernels add it"
    assert CAMERA.variance_dn2(np.zeros(3, np.float32)).dtype == np.float32
    assert CAMERA.variance_dn2(np.zeros(3)).dtype == np.float64


def test_electrons_scatter_by_their_root_and_in_the_dark_as_the_data_sheet_says() -> None:
    """EMVA 1288: of 10,000 electrons 100 are noise, one part in a hundred of the saturated grey value."""
    camera = camera_noise(full_well_e=10_000.0, read_noise_e=0.0, black_dn=0.0, gain_db=0.0)
    assert math.sqrt(camera.variance_dn2(255.0) - camera.variance_dn2(0.0)) == pytest.approx(2.55)
    assert camera.variance_dn2(0.0) == pytest.approx(1.0 / 12.0), "what is left is rounding to whole grey values"
    # 20 of 10,000 electrons are 0.51 of 255 grey values; at twice the gain they are twice as many.
    for gain_db, factor in ((0.0, 1.0), (20.0 * math.log10(2.0), 2.0), (20.0, 10.0)):
        camera = camera_noise(full_well_e=10_000.0, read_noise_e=20.0, black_dn=4.0, gain_db=gain_db)
        assert camera.black_dn == 4.0
        assert camera.variance_dn2(4.0) == pytest.approx((0.51 * factor) ** 2 + 1.0 / 12.0)
        assert camera.dn_per_e == pytest.approx(0.0255 * factor)
    assert MAD_TO_SIGMA * NormalDist().inv_cdf(0.75) == pytest.approx(1.0, abs=1e-4)


def test_each_camera_gets_its_own_part_and_a_third_one_there_is_not() -> None:
    both = StereoNoise(CAMERA, CameraNoise(0.6, 0.02, 2.0))
    assert [of_side(both, side) for side in SIDES] == [both.left, both.right]
    with pytest.raises(ValueError, match="middle"):
        of_side(both, "middle")


def test_a_fault_is_a_verdict_that_was_not_passed_and_another_one_with_other_numbers() -> None:
    numbers = {"received": 23.0, "expected": 24.0}
    fault = Fault(FaultCode.FRAME_MISSING, "23 of 24 frames arrived", numbers, "camera.left")
    told = Verdict("ledger", False, numbers, "FRAME_MISSING: 23 of 24 frames arrived")
    assert Verdict.failed("ledger", fault) == told
    assert Verdict.failed("ledger", Fault(FaultCode.LEAK)).text == "LEAK", "no colon with nothing behind it"
    faults = [Fault(FaultCode.FRAME_MISSING, "", {"received": received}) for received in (22.0, 23.0, 23.0)]
    assert len(set(faults)) == 2


def test_half_is_good_less_asks_back_more_asks_on_and_what_cannot_be_told_is_no_guidance() -> None:
    for share, move in ((0.0, Move.GO_BACK), (0.39, Move.GO_BACK), (0.41, Move.SCAN_NOW), (0.59, Move.SCAN_NOW), (0.61, Move.GO_ON)):  # fmt: skip
        assert Guidance(Overlap(share)).move is move
    assert LOST.move is Move.GO_BACK
    with pytest.raises(ValueError, match="guidance"):
        Guidance(UNKNOWN)


def test_longer_exposures_come_before_more_gain_and_each_step_is_brighter() -> None:
    steps = ladder(60.0, 500, 0.0, Span())
    times_us = [2000, 2500, 3200, 4000, 5000, 6300, 8000, 10000, 12000, 14000, 16000]
    assert [step.time_us for step in steps[:-6]] == times_us
    assert [(step.time_us, step.gain_db) for step in steps[-6:]] == [(16000, 2.0 * k) for k in range(1, 7)]
    lights = [step.light for step in steps]
    assert lights == sorted(lights)
    assert all(1.1 < b / a < 1.3 for a, b in pairwise(lights))


def test_no_exposure_ends_after_the_next_vertical_sync() -> None:
    """16.667 ms less the delay and 0.1 ms of margin."""
    assert ladder(60.0, 566, 0.0, Span())[-7].time_us == 16000
    assert ladder(60.0, 568, 0.0, Span())[-7].time_us == 14000
    assert [one.time_us for one in ladder(60.0, 500, 0.0, Span(3.0, 5.0, 0.0))] == [3200, 4000, 5000]


def test_gain_begins_with_the_rigs_own_and_ends_below_the_spans_in_whole_steps() -> None:
    for own_db, most_db, wanted in ((3.0, 8.0, [3.0, 5.0, 7.0]), (0.0, 5.0, [0.0, 2.0, 4.0]), (0.0, 1.9, [0.0])):
        steps = ladder(60.0, 500, own_db, Span(most_gain_db=most_db))
        assert [step.gain_db for step in steps if step.time_us == 16000] == wanted
        assert len(steps) == 10 + len(wanted), "the eleven times"
    assert {step.gain_db for step in ladder(60.0, 500, 12.0, Span())} == {12.0}


def test_of_few_exposures_the_gaps_are_bridged_by_gain_and_nothing_else_is_offered() -> None:
    steps = ladder(60.0, 500, 0.0, Span(times_ms=(16.0, 5.0, 12.0), most_gain_db=12.0))
    wanted = [*((5000, 2.0 * k) for k in range(4)), (12000, 0.0), *((16000, 2.0 * k) for k in range(7))]
    assert [(one.time_us, one.gain_db) for one in steps] == wanted
    lights = [step.light for step in steps]
    assert lights == sorted(lights)
    assert all(b / a < 1.4 for a, b in pairwise(lights)), "no gap that a proposal could fall into"
    own = ladder(60.0, 500, 6.0, Span(times_ms=(5.0, 16.0), most_gain_db=12.0))
    assert own[0] == Exposure(5000, 6.0)
    assert {one.time_us for one in own} == {5000, 16000}
    assert max(one.gain_db for one in own) == 12.0


def test_where_no_step_fits_the_reason_and_the_steps_are_told() -> None:
    said = r"no exposure step lies within 2\.\.1\.57 ms \(60 Hz less trigger delay 15000 us"
    with pytest.raises(ValueError, match=said):
        ladder(60.0, 15_000, 0.0, Span())


def test_an_exposure_is_as_bright_as_its_time_and_gain_and_says_so() -> None:
    assert Exposure(8000).light == 8000.0
    assert Exposure(8000, 20.0).light == pytest.approx(80_000.0)
    assert NOMINAL.label == "12 ms", "of an instrument whose rig file nobody has read"
    labels = [one.label for one in (Exposure(8000), Exposure(6300), Exposure(16000, 4.0))]
    assert labels == ["8 ms", "6.3 ms", "16 ms +4 dB"]


def test_good_is_three_fifths_of_the_surface_to_60_micrometres_and_usable_a_quarter_to_250() -> None:
    for coverage_percent, noise_mm, good, usable in (
        (60.0, 0.06, True, True), (59.9, 0.06, False, True), (60.0, 0.061, False, True), (100.0, 0.0, True, True), (25.0, 0.25, False, True),
        (24.9, 0.25, False, False), (25.0, 0.251, False, False), (None, 0.01, False, False), (90.0, None, False, False), (0.0, 0.01, False, False),
    ):  # fmt: skip
        said = grade(coverage_percent, noise_mm, ()) is Grade.GOOD, is_usable(coverage_percent, noise_mm)
        assert said == (good, usable), (coverage_percent, noise_mm)


@pytest.mark.parametrize("code", FaultCode)
def test_a_scan_whose_warning_says_repeat_is_not_good(code: FaultCode) -> None:
    """Whatever the diver is told to do about a scan: no green GOOD stands beside it."""
    said = grade(90.0, 0.02, [code])
    if RULES[code].severity is not Severity.INFO:
        assert said is not Grade.GOOD
    assert (said is Grade.GOOD) == (code in HARMLESS_FAULTS)
    assert (said is Grade.BAD) == (code in SPOILS_POINTS)
    assert "REPEAT" not in RULES[FaultCode.COMPENSATED].action.english


def test_what_spoils_points_is_worse_than_any_other_warning() -> None:
    spoiling = {FaultCode.MOVED, FaultCode.LIGHT_FLICKERS, FaultCode.SIDES_EXCHANGED, FaultCode.NOT_IN_WATER}
    assert spoiling == SPOILS_POINTS
    assert grade(90.0, 0.02, [FaultCode.TOO_BRIGHT, FaultCode.COMPENSATED]) is Grade.USABLE
    assert grade(90.0, 0.02, [FaultCode.TOO_BRIGHT, FaultCode.MOVED]) is Grade.BAD
    assert grade(20.0, 0.02, [FaultCode.TOO_BRIGHT]) is Grade.BAD
