"""One word for a scan: when it is good, worth keeping, or neither, and what forbids to call it good."""

from __future__ import annotations

import pytest

from appliance.machine.alerts import RULES, Severity
from appliance.scan.fault import FaultCode
from appliance.scan.grade import SPOILS_POINTS, TOLD_BESIDE_GOOD, Grade, grade, is_usable


@pytest.mark.parametrize(
    ("coverage_percent", "noise_mm", "good", "usable"),
    [
        (60.0, 0.06, True, True),
        (59.9, 0.06, False, True),
        (60.0, 0.061, False, True),
        (100.0, 0.0, True, True),
        (25.0, 0.25, False, True),
        (24.9, 0.25, False, False),
        (25.0, 0.251, False, False),
        (None, 0.01, False, False),
        (90.0, None, False, False),
        (0.0, 0.01, False, False),
    ],
)
def test_good_is_three_fifths_of_the_surface_to_60_micrometres_and_usable_a_quarter_to_250(
    coverage_percent: float | None, noise_mm: float | None, good: bool, usable: bool
) -> None:
    assert (grade(coverage_percent, noise_mm, ()) is Grade.GOOD) is good
    assert is_usable(coverage_percent, noise_mm) is usable


@pytest.mark.parametrize("code", FaultCode)
def test_a_scan_whose_warning_says_repeat_is_not_good(code: FaultCode) -> None:
    """Whatever the diver is told to do about a scan: no green GOOD stands beside it."""
    said = grade(90.0, 0.02, [code])
    if RULES[code].severity is not Severity.INFO:
        assert said is not Grade.GOOD
    assert (said is Grade.GOOD) == (code in TOLD_BESIDE_GOOD)
    assert (said is Grade.BAD) == (code in SPOILS_POINTS)
    assert "REPEAT" not in RULES[FaultCode.COMPENSATED].action.english


def test_what_spoils_points_is_worse_than_any_other_warning() -> None:
    assert {
        FaultCode.MOVED,
        FaultCode.LIGHT_FLICKERS,
        FaultCode.SIDES_EXCHANGED,
        FaultCode.NOT_IN_WATER,
    } == SPOILS_POINTS
    assert grade(90.0, 0.02, [FaultCode.TOO_BRIGHT, FaultCode.COMPENSATED]) is Grade.USABLE
    assert grade(90.0, 0.02, [FaultCode.TOO_BRIGHT, FaultCode.MOVED]) is Grade.BAD
    assert grade(20.0, 0.02, [FaultCode.TOO_BRIGHT]) is Grade.BAD
