"""What the diver reads: which message leads, what it costs, in which words, what is known already, and what stands beside the keys."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, permutations, product
from pathlib import Path
from string import Formatter

import pytest

from appliance.instrument.machine import alerts as rules
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.ashore import ASHORE
from appliance.instrument.machine.conditions import may_light, refusal
from appliance.instrument.machine.leading import (
    Leader,
    OverlapText,
    alerts,
    guidance_text,
    in_full,
    leader,
    on_screen,
    overlap_text,
    passing,
    urgency,
)
from appliance.instrument.machine.start import waits_for_ok
from appliance.instrument.machine.states import Device, Machine, Notice, NoticeKind, State, boot
from appliance.instrument.machine.words import Language, Text, worded
from appliance.instrument.ranging.reach import Reach
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import LOST, NO_OVERLAP, UNKNOWN, Guidance, Overlap
from appliance.measure.news import LiveGuidance
from appliance.measure.verdict import SPOILS_SCAN
from drivers.api import Key, KeyLongPress, KeyPress, KeyStuck, Telemetry
from tests.appliance.instrument.machine import walks as at
from tests.appliance.instrument.machine.courses import (
    BACK,
    DOWN,
    HOLD_DOWN,
    SCAN,
    STOP,
    UP,
    Then,
    codes,
    course,
    full,
    marks,
    raised,
    seen,
)
from tests.appliance.instrument.machine.walks import (
    HOLD_BACK,
    SECOND_NS,
    STARTS,
    WAYS,
    after,
    aim,
    heartbeat,
    in_menu,
    labels,
    run,
)
from tests.support import news

C, S = FaultCode, State
UNCALIBRATED = raised(C.UNCALIBRATED, "no file calibration/current.json")
FULL_DISK = on.StorageCounted(3, "000003", 0)
KEYS_GONE = on.DeviceDown(Device.KEYS, "gone")
LEFT_GONE = on.DeviceDown(Device.CAMERA_LEFT, "gone")
NUMBERS = {
    "error_percent": 0.6, "received": 23.0, "expected": 24.0, "shift_px": 12.3, "coverage_percent": 100.0, "temperature_c": 61.4,
    "supply_v": 10.4, "distance_mm": 437.0, "sight_m": 1.6,
}  # fmt: skip
DEVICES = (None, "camera.left", "camera.right", "cameras")


def case_warm(celsius: float) -> Telemetry:
    return heartbeat(temperature_case_c=celsius)


def supply(volts: float) -> on.ConditionRaised:
    return raised(C.SUPPLY_LOW, f"{volts} V", supply_v=volts)


def length_error(percent: float | None) -> on.ConditionRaised:
    numbers = {} if percent is None else {"error_percent": percent}
    return on.ConditionRaised(Fault(C.LENGTH_ERROR, "length error of the ball bar", numbers))


@pytest.mark.parametrize(
    ("start", "events", "facts"),
    [
        course("the mark stays in the menu", aim, UNCALIBRATED, BACK, UP, full=None, marks=["UNCALIBRATED"]),
        course("in the gallery", aim, UNCALIBRATED, BACK, DOWN, full=None, marks=["UNCALIBRATED"]),
        course("and while a scan is recorded", aim, UNCALIBRATED, BACK, SCAN, on.Armed(1), full=None, marks=["UNCALIBRATED"]),
        *(course(f"held on in {way.__name__}", way, UNCALIBRATED, *HOLD_BACK, state=way().state, scan=way().scan, asked=False,
                 never=do.Reject) for way in (aim, at.reviewing)),
        course("told again it is no news", aim, UNCALIBRATED, BACK, UNCALIBRATED, full=None),
        course("for another reason it is", aim, UNCALIBRATED, BACK, raised(C.UNCALIBRATED, "of KF-0002"), full="UNCALIBRATED"),
        course("what ended is forgotten", aim, KEYS_GONE, BACK, on.DeviceUp(Device.KEYS), full=None, acknowledged=()),
        course("and comes again as news", aim, KEYS_GONE, BACK, on.DeviceUp(Device.KEYS), KEYS_GONE, full="KEYS LOST"),
        course("a temperature that trembles", aim, case_warm(51.0), BACK, case_warm(52.4), full=None, marks=["WARM 52 °C"]),
        course("one that rises", aim, case_warm(51.0), BACK, case_warm(52.4), case_warm(53.0), full="WARM 53 °C"),
        course("one that fell a little", aim, case_warm(55.0), BACK, case_warm(53.5), full=None, marks=["WARM 54 °C"]),
        course("a supply that sags a little", aim, supply(10.4), BACK, supply(10.2), full=None),
        course("further", aim, supply(10.4), BACK, supply(10.2), supply(10.1), full="SUPPLY LOW 10.1V"),
        *(course(f"a length error of {known} and then {now}", aim, length_error(known), BACK, length_error(now), full=said)
          for known, now, said in ((0.5, 0.65, None), (0.5, 0.75, "LENGTH ERR 0.8 %"), (0.5, 0.2, None), (None, 0.5, "LENGTH ERR 0.5 %"),
                                   (0.5, None, None), (None, None, None))),
        course("each is read before it is known", aim, UNCALIBRATED, FULL_DISK, full="STORAGE FULL"),
        course("one by one", aim, UNCALIBRATED, FULL_DISK, BACK, full="UNCALIBRATED", marks=["STORAGE FULL"]),
        course("known it still forbids", aim, UNCALIBRATED, FULL_DISK, BACK, BACK, SCAN, state=S.AIM),
        course("what is critical stays", aim, raised(C.LASER_ON), UNCALIBRATED, BACK, full="LASER ON", on_back="HOLD: OFF"),
        course("BACK ends a recording first", at.capturing, UNCALIBRATED, on_back="STOP"),
        course("whatever is wrong", at.capturing, UNCALIBRATED, BACK, state=S.AIM),
        course("calibrating is the remedy", at.calibrating, UNCALIBRATED, on_back="BACK"),
        course("and needs no key", at.calibrating, UNCALIBRATED, BACK, full="UNCALIBRATED"),
        course("after a refused scan BACK says SEEN", aim, LEFT_GONE, SCAN, first=("LEFT CAM LOST", "SCAN REFUSED"), on_back="SEEN"),
        course("and does it", aim, LEFT_GONE, SCAN, BACK, full=None, on_back="HOLD: OFF"),
        course("news of the last run is told", lambda: boot(0), on.FaultReported(Fault(C.RESTARTED)), on.Tick(1), codes=[C.RESTARTED]),
        course("until the next key", lambda: boot(0), on.FaultReported(Fault(C.RESTARTED)), on.Tick(1), UP, codes=[]),
        course("after the end no key has a label", aim, UNCALIBRATED, STOP, labels={}),
    ],
)  # fmt: skip
def test_what_lasts_is_taken_for_known_with_one_key_and_told_anew_when_it_is_news(
    start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, object]
) -> None:
    assert seen(start, events, facts) == facts


@pytest.mark.parametrize("way", [aim, in_menu, at.in_gallery, at.reviewing, at.saving])
def test_back_takes_a_lasting_warning_for_known_and_does_nothing_else(way: Callable[[], Machine]) -> None:
    machine = run(way(), UNCALIBRATED)
    assert (labels(machine)[Key.BACK], full(machine)) == ("SEEN", "UNCALIBRATED")
    known, effects = after(machine, BACK)
    assert (full(known), marks(known), effects) == (None, ["UNCALIBRATED"], [])
    assert labels(known) == labels(way()), "its key means again what it always means"
    # But for what is known, and when a key was pressed, it is the machine that it was.
    as_it_was = {name: getattr(machine, name) for name in ("acknowledged", "last_key_ns", "back_from", "back_spent")}
    assert replace(known, **as_it_was) == machine


@pytest.mark.parametrize("code", [code for code, rule in rules.RULES.items() if rule.passing])
def test_what_comes_and_goes_with_the_live_picture_is_never_in_full_and_needs_no_key(code: FaultCode) -> None:
    machine = run(aim(), raised(code, "", "live view"))
    assert (codes(machine), full(machine), labels(machine)) == ([code], None, labels(aim()))
    assert full(run(machine, UNCALIBRATED)) == "UNCALIBRATED"


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
    for order in list(permutations(ordered))[::7]:
        assert tuple(codes(run(aim(), *map(raised, order)))) == ordered


def test_of_any_two_faults_one_leads_whichever_came_first() -> None:
    ready, of = aim(), {code: rules.alert_of(Fault(code)) for code in C}
    for number, (one, other) in enumerate(combinations(C, 2)):
        first, last = sorted((one, other), key=urgency)
        assert of[first].severity >= of[last].severity
        # The order in which they came changes from pair to pair.
        came = (Fault(one), Fault(other)) if number % 2 else (Fault(other), Fault(one))
        said = [alert for alert in alerts(replace(ready, conditions=came)) if alert.code in (one, other)]
        assert [alert.code for alert in said] == [first, last]
        leads = in_full(said)
        assert leads is None or leads.code is (last if of[first].passing else first)


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


NOTHING_SHARED = OverlapText((Text.NO_OVERLAP, Text.GO_BACK), warns=True)


def test_beside_an_alert_in_full_a_lack_of_overlap_and_a_distance_do_not_lead() -> None:
    for code, rule in rules.RULES.items():
        said = (rules.alert_of(Fault(code)),)
        expected = Leader.PASSING if rule.passing else Leader.ALERT
        if rule.severity is rules.Severity.INFO:
            expected = Leader.OVERLAP
        assert leader(said, NOTHING_SHARED) is expected, code
        for reach in (Reach.CLOSER, Reach.BACK):
            outside = leader(said, NOTHING_SHARED, reach)
            assert outside is (Leader.ALERT if expected is Leader.ALERT else Leader.DISTANCE), code
        assert rule.passing or leader((replace(said[0], is_acknowledged=True),), NOTHING_SHARED) is Leader.OVERLAP, code


def test_the_title_tells_what_passes_and_where_nothing_is_wrong_the_screen_says_its_own_words() -> None:
    lasts, passes = rules.alert_of(Fault(C.UNCALIBRATED)), rules.alert_of(Fault(C.AIM_FAST))
    assert (passing((lasts, passes)), passing((lasts,))) == (passes, None)
    assert leader(()) is leader((), OverlapText((Text.OVERLAP, "62 %"))) is Leader.SCREEN
    assert leader((), NOTHING_SHARED) is Leader.OVERLAP


@pytest.mark.parametrize("code", [C.AIM_LIGHT, C.AIM_DARK, C.AIM_TURBID])
def test_light_is_not_judged_on_the_screen_before_the_distance_is_right(code: FaultCode) -> None:
    for reach in Reach:
        machine = replace(run(aim(), raised(code)), reach=reach)
        assert bool(on_screen(machine)) == (reach in (Reach.OK, Reach.UNKNOWN))
        assert alerts(machine), "the log and the status file know it"


NEEDED = {C.CAMERA_LOST, C.CAMERA_SLOW_LINK, C.CAMERA_REFUSED, C.PROJECTOR_LOST, C.BOARD_LOST, C.VSYNC_LOST, C.LASER_ON}
HEAT_AND_WATER = {C.HOT, C.TOO_HOT, C.LEAK}
REFUSES = NEEDED | HEAT_AND_WATER | {C.STORAGE_FULL, C.DISK_READ_ONLY, C.DISK_REFUSES, C.SUPPLY_LOW}
WITNESSES = {
    C.FRAME_MISSING, C.FRAME_REPEATED, C.FRAME_ORDER, C.FRAME_TRUNCATED, C.FRAME_CORRUPT, C.CAMERA_STUCK, C.CAMERA_TOO_SLOW,
    C.CAMERA_SILENT, C.PATTERN_WRONG, C.PICTURE_MIRRORED, C.SYNC_LOST, C.LATE_FLIP, C.PROJECTOR_TIMING, C.PROJECTOR_DARK,
    C.PULSE_MISSING, C.CAPTURE_TIMEOUT, C.BOARD_RESET, C.INTERNAL,
}  # fmt: skip
"""Frames, flips and pulses did not agree, or nobody knows what happened: no point of such a scan can be believed."""


@pytest.mark.parametrize("code", FaultCode)
def test_what_a_fault_costs_is_what_its_rule_says_and_what_the_machine_does(code: FaultCode) -> None:
    rule, event = rules.RULES[code], raised(code)
    found = (rule.stops_capture, rule.forbids_light, rule.blocks_scan, code in SPOILS_SCAN, rule.doubts_lengths)
    wanted = (
        code in NEEDED, code in HEAT_AND_WATER, code in REFUSES, code in WITNESSES,
        code in (C.UNCALIBRATED, C.LENGTH_ERROR, C.VERIFY_CALIBRATION),
    )  # fmt: skip
    assert found == wanted
    assert (run(at.capturing(), event).state is not S.CAPTURE) == (code in NEEDED | HEAT_AND_WATER)
    assert (run(aim(), event, SCAN).state is not S.ARMED) == (code in REFUSES)
    assert may_light(run(aim(), event)) == (code not in HEAT_AND_WATER)
    machine, effects = after(at.reconstructing(), news.failed(1, Fault(code, "because")))
    assert any(isinstance(effect, do.Reject) for effect in effects) == (code in WITNESSES)
    assert (machine.state is S.REVIEW) == (code not in WITNESSES)


def test_lengths_are_doubted_as_long_as_one_reason_lasts() -> None:
    for events, doubted in (
        ((), False), ((raised(C.STORAGE_FULL),), False), ((UNCALIBRATED, raised(C.STORAGE_FULL)), True),
        ((UNCALIBRATED, on.ConditionCleared(C.UNCALIBRATED)), False),
    ):  # fmt: skip
        assert rules.lengths_doubtful(run(aim(), *events)) == doubted


def test_a_scan_is_refused_with_the_gravest_reason_and_news_are_no_warning() -> None:
    for order in permutations((C.STORAGE_FULL, C.LASER_ON, C.SUPPLY_LOW)):
        reason = refusal(run(aim(), *map(raised, order)))
        assert reason is not None
        assert reason.code is C.LASER_ON
    grave = [rules.alert_of(Fault(code)).severity for code in (C.COMPENSATED, C.MOVED, C.LEAK)]
    assert grave == [rules.Severity.INFO, rules.Severity.WARNING, rules.Severity.CRITICAL]
    alert = rules.alert_of(Fault(C.UNCALIBRATED))
    assert (alert.lasts, alert.is_acknowledged, alert.passing) == (False, False, False)


@pytest.mark.parametrize(
    ("percent", "in_english", "in_german"),
    [
        (2.3, "LENGTH ERR 2.3 %", "LÄNGENFEHLER 2.3 %"),
        (12.3, "LENGTH ERROR", "LÄNGENFEHLER 12.3 %"),
        (12345.6, "LENGTH ERROR", "LÄNGENFEHLER"),
    ],
)
def test_a_number_that_is_too_long_for_the_screen_is_left_out_whole(
    percent: float, in_english: str, in_german: str
) -> None:
    fault = Fault(C.LENGTH_ERROR, "", {"error_percent": percent})
    assert (rules.headline_of(fault), rules.headline_of(fault, Language.GERMAN)) == (in_english, in_german)


@pytest.mark.parametrize("code", FaultCode)
def test_every_fault_has_its_words_in_both_languages_with_their_numbers_and_within_the_room(code: FaultCode) -> None:
    rule = rules.RULES[code]
    for words in (rule.headline, rule.action, rule.plain, rule.exchanged):
        assert words is None or (words.english and words.german)
    english_fields, german_fields = (
        {name for _, name, _, _ in Formatter().parse(text) if name} for text in (rule.headline.english, rule.headline.german)
    )  # fmt: skip
    sides = {"side", "window_side"}
    assert english_fields - sides == german_fields - sides
    for numbers, device in product(({}, NUMBERS), DEVICES):
        fault = Fault(code, "detail", numbers, device)
        alert = rules.alert_of(fault)
        assert alert.german is not None
        for (headline, action), language in (
            ((alert.headline, alert.action), Language.ENGLISH),
            (alert.german, Language.GERMAN),
        ):
            assert 0 < len(headline) <= rules.LONGEST[language]
            assert 0 < len(action) <= 32
            assert "{" not in headline
            # A template that is too long with real numbers would lose them.
            assert numbers is not NUMBERS or not english_fields - sides or any(letter.isdigit() for letter in headline)
        if english_fields & sides:
            assert ("LINK" in alert.german[0]) == (device == "camera.left")
            assert ("RECHT" in alert.german[0]) == (device == "camera.right")
        for kind in NoticeKind:
            said = alerts(replace(boot(0), notice=Notice(fault, kind)))[0]
            assert said.german is not None
            assert len(said.german[1]) <= rules.LONGEST[Language.GERMAN] + len(": ERSTER BLEIBT")
            assert said.german != (said.headline, said.action)


INSIDE = (
    "CONNECTOR|CABLES?|SERIALS?|FILE|LOG|LUT|GAMMA|TRIGGER|VIDEO|LENS|BOARD|PLUG|SETTINGS|LATENCY|DRIVER|DRY|INSIDE|STECKER|KABEL|"
    "VIDEOKABEL|TRIGGERKABEL|NUMMERN|DATEI|PROTOKOLL|PLATINE|EINSTELLUNG|TROCKNEN|INNEN"
)
"""Things inside of the housing, or on a desk: no diver can reach them."""


def test_every_remedy_is_possible_under_water_and_ends_the_dive_where_no_scan_is() -> None:
    ends = ("END DIVE", "BLOCKED", "SWITCHING OFF", "SCANS ARE SAFE")
    for code, rule in rules.RULES.items():
        for words in (rule.action.english, rule.action.german):
            assert not re.search(rf"\b({INSIDE})\b", words.upper()), code
        if rule.blocks_scan or rule.stops_capture:
            assert any(words in rule.action.english for words in ends), code


@pytest.mark.parametrize(
    ("device", "action"),
    [
        ("camera.left", "LEFT CAMERA EXCHANGED"), ("camera.right", "RIGHT CAMERA EXCHANGED"), ("cameras", "CAMERAS EXCHANGED"),
        (None, "LENGTHS NOT TRUSTED"), ("board", "LENGTHS NOT TRUSTED"),
    ],
)  # fmt: skip
def test_an_exchanged_camera_is_named_as_the_reason(device: str | None, action: str) -> None:
    assert rules.action_of(Fault(C.UNCALIBRATED, device=device)) == action
    german = rules.action_of(Fault(C.UNCALIBRATED, device=device), Language.GERMAN)
    assert (german == rules.action_of(Fault(C.UNCALIBRATED), Language.GERMAN)) == (not action.endswith("EXCHANGED"))
    assert rules.action_of(Fault(C.CAMERA_LOST, device=device)) == "OFF AND ON, OR END DIVE"


def test_the_faults_page_says_what_to_look_at_ashore() -> None:
    page = (Path(__file__).parents[4] / "docs" / "faults.md").read_text(encoding="utf-8")
    assert all(f"| {code.value} | {text} |" in page for code, text in ASHORE.items())
    switched = {code for code, rule in rules.RULES.items() if "OFF AND ON" in rule.action.english}
    assert switched <= ASHORE.keys() | {C.INTERNAL}, "a diver who is sent up is told ashore what it was"


def forgetful(machine: Machine) -> Machine:
    plain = replace(machine, last_key_ns=None, back_from=None, back_spent=False)
    return replace(plain, notice=None, just_saved=None, insists_until_ns=None)


def does(machine: Machine, *events: on.Event) -> bool:
    """Whether these events change anything that the diver could see."""
    then, effects = after(machine, *events)
    return bool(effects) or forgetful(then) != forgetful(machine)


@pytest.mark.parametrize("start", [way() for way in STARTS], ids=lambda m: m.state.value)
def test_a_key_has_a_label_where_it_does_something_and_nowhere_else(start: Machine) -> None:
    for key in Key:
        pressed, held = (KeyPress(key, 0),), (KeyPress(key, 0), KeyLongPress(key, 0))
        label = labels(start).get(key)
        if label is None:
            assert not does(start, *held), f"{key} does something and says nothing"
        elif label.startswith("HOLD: "):
            # Whoever is asked to go on goes on with BACK as well.
            assert does(start, *pressed) == waits_for_ok(start), f"{key} must be held"
            assert does(start, *held), f"{key} says {label} and does nothing"
        else:
            assert does(start, *pressed), f"{key} says {label} and does nothing"


@pytest.mark.parametrize(("jammed", "stand_in"), [(Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)])
def test_another_key_takes_over_a_stuck_one_with_its_label(jammed: Key, stand_in: Key) -> None:
    machine = run(at.reviewing(), KeyStuck(jammed))
    machine = run(machine, KeyPress(Key.DOWN if jammed is Key.BACK else Key.BACK, 0))  # seen
    assert labels(machine)[stand_in] == labels(at.reviewing())[jammed]
    assert jammed not in labels(machine)
    assert run(machine, KeyPress(stand_in, 0)).state is run(at.reviewing(), KeyPress(jammed, 0)).state
    assert run(machine, KeyPress(jammed, 0), KeyPress(stand_in, 0)).stuck == frozenset()


def test_up_turns_the_cloud_and_down_never_does() -> None:
    for keys, turn in (((), 0), ((UP,), 1), ((UP, UP), 2), ((DOWN,), 0), ((UP, DOWN), 1), (HOLD_DOWN, 0)):
        scan = run(at.reviewing(), *keys).scan
        assert scan is not None
        assert scan.turn_steps == turn


def of_object(machine: Machine, number: int | None = 3) -> Machine:
    return replace(machine, choices=replace(machine.choices, object=number, objects=number or 0))


def overlap(machine: Machine) -> tuple[str, bool] | None:
    found = overlap_text(machine)
    return None if found is None else (worded(found.label), found.warns)


@pytest.mark.parametrize(
    ("share", "words", "warns", "alone"),
    [
        (Overlap(0.623), "OVERLAP 62 %", False, True),
        (Overlap(0.12), "OVERLAP 12 %", True, True),
        (Overlap(0.05), "NO OVERLAP: GO BACK", True, False),
        (NO_OVERLAP, "NO OVERLAP: GO BACK", True, False),
        (UNKNOWN, "OVERLAP NOT SURE", False, False),
    ],
)
def test_the_overlap_is_said_in_words_and_a_lack_of_it_only_of_an_object(
    share: Overlap, words: str, warns: bool, alone: bool
) -> None:
    assert overlap(run(of_object(at.reviewing()), news.overlap(1, share))) == (words, warns)
    said = overlap(run(of_object(at.reviewing(), None), news.overlap(1, share)))
    assert (said is not None and said[0] == words) == alone, "scans of nothing in particular"


NONE_TOLD, KEEP = news.overlap(1, NO_OVERLAP), (SCAN, on.RawStored(1), on.Saved(1, "000001"))
ANOTHER_OBJECT = tuple(KeyPress(key, 0) for key in (Key.UP, *(Key.DOWN,) * 4, Key.SCAN, Key.UP, Key.SCAN))


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ((), False),
        ((news.overlap(7, NO_OVERLAP),), False),  # of another scan
        ((*KEEP, NONE_TOLD), True),
        ((*KEEP, NONE_TOLD, SCAN), False),
        ((*KEEP, SCAN, NONE_TOLD), False),  # too late
        ((NONE_TOLD, *HOLD_BACK), False),
        ((*HOLD_BACK, NONE_TOLD), False),  # rejected
        ((on.ObjectsCounted(3), *KEEP, NONE_TOLD, *ANOTHER_OBJECT), False),
    ],
)
def test_an_overlap_is_read_until_the_next_scan_or_object_begins(events: tuple[on.Event, ...], said: bool) -> None:
    assert (overlap(run(of_object(at.reviewing()), *events)) is not None) == said


TAKEN_NS = 50 * SECOND_NS


def guided(guidance: Guidance | None, *events: on.Event, number: int | None = 3) -> Machine:
    return run(of_object(run(aim(), on.Tick(TAKEN_NS)), number), LiveGuidance(guidance, TAKEN_NS), *events)


def said_of(machine: Machine) -> str | None:
    found = guidance_text(machine)
    return None if found is None else found.english


@pytest.mark.parametrize(
    ("guidance", "words", "german"),
    [
        (Guidance(Overlap(0.238), (-1.0, 0.0)), "OVERLAP 25 %: GO BACK", "ÜBERLAPP 25 % UMKEHREN"),
        (Guidance(Overlap(0.52)), "OVERLAP 50 %: SCAN NOW", "ÜBERLAPP 50 % SCANNEN"),
        (Guidance(Overlap(0.83), (-1.0, 0.0)), "OVERLAP 85 %: GO ON", "ÜBERLAPP 85 % WEITER"),
        (LOST, "GO BACK", "UMKEHREN"),
    ],
)
def test_the_way_is_said_in_steps_with_the_move_and_its_arrow(guidance: Guidance, words: str, german: str) -> None:
    found = guidance_text(guided(guidance))
    assert found is not None
    assert (found.english, found.toward) == (words, guidance.toward)
    parts = [worded(label, Language.GERMAN) for label in (found.overlap, found.instruction) if label is not None]
    assert " ".join(parts) == german


@pytest.mark.parametrize("reach", [Reach.CLOSER, Reach.BACK])
def test_nobody_is_told_to_scan_where_the_distance_is_wrong(reach: Reach) -> None:
    found = guidance_text(replace(guided(Guidance(Overlap(0.5))), reach=reach))
    assert found is not None
    assert (found.instruction, found.move, found.toward) == (None, None, None), "the distance leads, without a colour"
    assert found.overlap is not None
    assert worded(found.overlap, Language.ENGLISH) == "OVERLAP 50 %"


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ((on.Tick(TAKEN_NS + 14 * SECOND_NS // 10),), "GO BACK"),
        ((on.Tick(TAKEN_NS + 16 * SECOND_NS // 10),), None),
        ((on.Tick(TAKEN_NS + 2 * SECOND_NS), LiveGuidance(LOST, TAKEN_NS)), None),  # the picture's age counts
        ((LiveGuidance(None, TAKEN_NS + SECOND_NS),), "GO BACK"),
        ((LiveGuidance(None, TAKEN_NS + SECOND_NS), on.Tick(TAKEN_NS + 16 * SECOND_NS // 10)), None),
        ((SCAN, LiveGuidance(LOST, TAKEN_NS)), None),
        ((UP,), None),
    ],
)
def test_the_way_is_said_for_a_second_and_a_half_while_aiming(events: tuple[on.Event, ...], said: str | None) -> None:
    assert said_of(guided(LOST, *events)) == said
    assert said_of(guided(LOST, number=None)) is None, "of no object"


def test_overlaps_and_ways_lead_nowhere() -> None:
    for way in WAYS.values():
        before = way()
        for event in (LiveGuidance(LOST, before.now_ns), news.overlap(before.captures, NO_OVERLAP)):
            assert run(before, event).state is before.state
    assert run(aim(), news.overlap(0, NO_OVERLAP)).overlap is None
