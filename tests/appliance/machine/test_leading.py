"""One message leads a screen, whatever else there is to say, and every remedy in it is possible under water."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest

from appliance.machine import events as on
from appliance.machine.alerts import RULES, Severity, alert_of
from appliance.machine.ashore import ASHORE
from appliance.machine.leading import Leader, alerts, in_full, leader, on_screen, passing, urgency
from appliance.machine.overlaps import OverlapSaid
from appliance.machine.states import Device
from appliance.machine.words import Text
from appliance.ranging.reach import Reach
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import aim, reviewing, run

C = FaultCode
NO_OVERLAP = OverlapSaid((Text.NO_OVERLAP, Text.GO_BACK), warns=True)
INSIDE = [
    "CONNECTOR",
    "CABLE",
    "CABLES",
    "SERIAL",
    "SERIALS",
    "FILE",
    "LOG",
    "LUT",
    "GAMMA",
    "TRIGGER",
    "VIDEO",
    "LENS",
    "BOARD",
    "PLUG",
    "SETTINGS",
    "LATENCY",
    "DRIVER",
    "STECKER",
    "KABEL",
    "VIDEOKABEL",
    "TRIGGERKABEL",
    "NUMMERN",
    "DATEI",
    "PROTOKOLL",
    "PLATINE",
    "EINSTELLUNG",
    "DRY",
    "TROCKNEN",
    "INNEN",
    "INSIDE",
]
"""Things inside of the housing, or on a desk: no diver can reach them."""


@pytest.mark.parametrize("code", FaultCode)
def test_no_remedy_names_a_thing_inside_of_the_housing(code: FaultCode) -> None:
    for words in (RULES[code].action.english, RULES[code].action.german):
        assert not set(re.findall(r"\w+", words.upper())) & set(INSIDE), words


@pytest.mark.parametrize("code", sorted((c for c in C if RULES[c].blocks_scan or RULES[c].stops_capture), key=str))
def test_what_stops_all_scans_says_how_the_dive_ends(code: FaultCode) -> None:
    """Whoever is told only what is broken waits for it to mend itself."""
    ends = ("END DIVE", "BLOCKED", "SWITCHING OFF", "SCANS ARE SAFE")
    assert any(words in RULES[code].action.english for words in ends)


def test_of_any_two_faults_one_leads_whichever_came_first() -> None:
    ready, of = aim(), {code: alert_of(Fault(code)) for code in C}
    for number, (one, other) in enumerate(combinations(C, 2)):
        first, last = sorted((one, other), key=urgency)
        assert of[first].severity >= of[last].severity
        # The order in which they came changes from pair to pair.
        came = (Fault(one), Fault(other)) if number % 2 else (Fault(other), Fault(one))
        shown = [alert for alert in alerts(replace(ready, conditions=came)) if alert.code in (one, other)]
        assert [alert.code for alert in shown] == [first, last]
        full = in_full(shown)
        assert full is None or full.code is (last if of[first].passing else first)


@pytest.mark.parametrize(
    "ordered",
    [
        (C.LEAK, C.LASER_ON, C.NOT_SAVED, C.CAMERA_LOST, C.FRAME_MISSING, C.MOVED, C.SCAN_FAR, C.UNCALIBRATED, C.COMPENSATED),
        (C.SIDES_EXCHANGED, C.SCAN_NEAR, C.AMBIENT, C.WATER_DIRTY, C.TOO_BRIGHT, C.SCAN_POOR, C.WARM),
        (C.AIM_LIGHT, C.AIM_FAST, C.AIM_TURBID, C.AIM_DARK),
    ],
)  # fmt: skip
def test_remedies_come_in_the_order_in_which_they_are_done(ordered: tuple[FaultCode, ...]) -> None:
    assert [urgency(code) for code in ordered] == sorted(urgency(code) for code in ordered)


@pytest.mark.parametrize("code", FaultCode)
def test_beside_an_alert_in_full_a_lack_of_overlap_and_a_distance_do_not_lead(code: FaultCode) -> None:
    shown = (alert_of(Fault(code)),)
    if RULES[code].severity is Severity.INFO:
        expected = Leader.OVERLAP
    else:
        expected = Leader.PASSING if RULES[code].passing else Leader.ALERT
    assert leader(shown, NO_OVERLAP) is expected
    for reach in (Reach.CLOSER, Reach.BACK):
        outside = leader(shown, NO_OVERLAP, reach)
        assert outside is (Leader.ALERT if expected is Leader.ALERT else Leader.DISTANCE)
    known = (replace(shown[0], seen=True),)
    if not RULES[code].passing:
        assert leader(known, NO_OVERLAP) is Leader.OVERLAP


def test_the_title_tells_what_passes_and_never_what_lasts() -> None:
    lasts, passes = alert_of(Fault(C.UNCALIBRATED)), alert_of(Fault(C.AIM_FAST))
    assert passing((lasts, passes)) is passes
    assert passing((lasts,)) is None


def test_where_nothing_is_wrong_the_screen_says_its_own_words() -> None:
    assert leader(()) is Leader.SCREEN
    assert leader((), OverlapSaid((Text.OVERLAP, "62 %"))) is Leader.SCREEN
    assert leader((), NO_OVERLAP) is Leader.OVERLAP


@pytest.mark.parametrize("code", [C.AIM_LIGHT, C.AIM_DARK, C.AIM_TURBID])
@pytest.mark.parametrize("reach", Reach)
def test_light_is_not_judged_on_the_screen_before_the_distance_is_right(code: FaultCode, reach: Reach) -> None:
    """What is too near is too bright of itself."""
    machine = replace(run(aim(), on.ConditionRaised(Fault(code))), reach=reach)
    assert bool(on_screen(machine)) == (reach in (Reach.OK, Reach.UNKNOWN))
    assert alerts(machine), "the log and the status file know it"


def test_after_a_refused_scan_back_does_what_its_label_says() -> None:
    machine = run(aim(), on.DeviceDown(Device.CAMERA_LEFT, "gone"), on.KeyPressed(Key.SCAN))
    assert (alerts(machine)[0].action, labels(machine)[Key.BACK]) == ("SCAN REFUSED", "SEEN")
    machine = run(machine, on.KeyPressed(Key.BACK))
    assert in_full(alerts(machine)) is None, "one press, and the warning is a mark"
    assert labels(machine)[Key.BACK] == "HOLD: OFF"


def test_down_means_the_exposure_in_every_review_or_nothing() -> None:
    for said in (on.Judged(1), on.Judged(1, (Fault(C.MOVED),))):
        assert Key.DOWN not in labels(run(reviewing(), said))


def test_the_faults_page_says_what_to_look_at_ashore() -> None:
    page = (Path(__file__).parents[3] / "docs" / "faults.md").read_text(encoding="utf-8")
    for code, text in ASHORE.items():
        assert f"| {code.value} | {text} |" in page
    switched = {code for code, rule in RULES.items() if "OFF AND ON" in rule.action.english}
    assert switched <= ASHORE.keys() | {C.INTERNAL}, "a diver who is sent up is told ashore what it was"
