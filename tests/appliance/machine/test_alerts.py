"""Which message stands first, which one is shown in full again, and what a failed scan is said to have failed by."""

from __future__ import annotations

from itertools import permutations

import pytest

from appliance.machine import events as on
from appliance.machine.alerts import Severity, alert_of, headline_of, lengths_doubtful
from appliance.machine.leading import alerts, in_full
from appliance.machine.permissions import refusal
from appliance.machine.states import Machine
from appliance.machine.words import Language
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.walks import aim, capturing, heartbeat, run

C = FaultCode
BACK = on.KeyPressed(Key.BACK)


def raised(*codes: FaultCode) -> tuple[on.Event, ...]:
    return tuple(on.ConditionRaised(Fault(code)) for code in codes)


def full(machine: Machine) -> str | None:
    alert = in_full(alerts(machine))
    return None if alert is None else alert.headline


@pytest.mark.parametrize(
    "ordered",
    [
        (C.LEAK, C.LASER_ON, C.NOT_SAVED, C.STORAGE_FULL, C.UNCALIBRATED),
        (C.HOT, C.LASER_ON, C.NOT_SAVED, C.DISK_REFUSES, C.WINDOW),
    ],
)
def test_the_gravest_comes_first_then_what_keeps_it_dark_then_what_forbids_a_scan(
    ordered: tuple[FaultCode, ...],
) -> None:
    for order in permutations(ordered):
        machine = run(aim(), *raised(*order))
        assert tuple(alert.code for alert in alerts(machine)) == ordered


def test_a_corrected_scan_is_told_without_a_warning() -> None:
    assert alert_of(Fault(C.COMPENSATED)).severity is Severity.INFO
    assert alert_of(Fault(C.MOVED)).severity is Severity.WARNING
    assert alert_of(Fault(C.LEAK)).severity is Severity.CRITICAL
    assert len({Severity.INFO, Severity.WARNING, Severity.CRITICAL}) == 3


def test_a_scan_is_refused_with_the_gravest_reason() -> None:
    for order in permutations((C.STORAGE_FULL, C.LASER_ON, C.SUPPLY_LOW)):
        reason = refusal(run(aim(), *raised(*order)))
        assert reason is not None
        assert reason.code is C.LASER_ON


def test_a_capture_that_heat_ends_is_said_to_have_failed_by_heat() -> None:
    machine = run(capturing(), heartbeat(temperature_case_c=60.0))
    first = alerts(machine)[0]
    assert (first.headline, first.action) == ("SCAN FAILED", "HOT 60 °C: REPEAT")


def length_error(percent: float | None) -> on.ConditionRaised:
    numbers = {} if percent is None else {"error_percent": percent}
    return on.ConditionRaised(Fault(C.LENGTH_ERROR, "the ball bar came out wrong", numbers))


@pytest.mark.parametrize(
    ("known", "now", "shown"),
    [
        (0.5, 0.5, False),
        (0.5, 0.65, False),
        (0.5, 0.75, True),
        (0.5, 0.2, False),
        (None, 0.5, True),  # nobody knew how much
        (0.5, None, False),
        (None, None, False),
    ],
)
def test_a_known_length_error_is_shown_in_full_again_where_it_has_become_noticeably_larger(
    known: float | None, now: float | None, shown: bool
) -> None:
    machine = run(aim(), length_error(known), BACK)
    assert full(machine) is None
    assert (full(run(machine, length_error(now))) is not None) == shown


def test_lengths_are_doubted_as_long_as_one_reason_lasts() -> None:
    assert not lengths_doubtful(aim())
    assert not lengths_doubtful(run(aim(), *raised(C.STORAGE_FULL)))
    machine = run(aim(), *raised(C.UNCALIBRATED, C.STORAGE_FULL))
    assert lengths_doubtful(machine)
    assert not lengths_doubtful(run(machine, on.ConditionCleared(C.UNCALIBRATED)))


@pytest.mark.parametrize(
    ("percent", "english", "german"),
    [
        (2.3, "LENGTH ERR 2.3 %", "LÄNGENFEHLER 2.3 %"),
        (12.3, "LENGTH ERROR", "LÄNGENFEHLER 12.3 %"),
        (1234.5, "LENGTH ERROR", "LÄNGENFEHLER 1234.5 %"),
        (12345.6, "LENGTH ERROR", "LÄNGENFEHLER"),
    ],
)
def test_a_number_that_is_too_long_for_the_screen_is_left_out_whole(percent: float, english: str, german: str) -> None:
    """A headline has room for 16 letters in English and 21 in German; half a number is worse than none."""
    fault = Fault(FaultCode.LENGTH_ERROR, "", {"error_percent": percent})
    assert (headline_of(fault), headline_of(fault, Language.GERMAN)) == (english, german)
