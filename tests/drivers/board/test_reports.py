"""What the board's reports mean, and that a sensor without a value is no zero."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import BoardBooted, LaserState, Pulse, PulsesDone, Telemetry, VsyncLost
from drivers.board.line import Kind, MalformedLine, Sentence
from drivers.board.reports import parse_info, parse_lasers, parse_refusal, parse_report


def report(verb: str, *fields: str) -> Sentence:
    return Sentence(Kind.REPORT, 1, verb, fields)


def test_reports_become_events_up_to_the_largest_numbers_of_the_protocol() -> None:
    largest = ("63", "4294967295", "18446744073709551615")
    for words, event in (
        (("PULSE", "3", "90127", "1502783412"), Pulse(3, 90127, 1502783412)),
        (("PULSE", *largest), Pulse(*map(int, largest))),
        (("DONE", "64"), PulsesDone(64)),
        (("NOSYNC",), VsyncLost()),
        (("DEPTH", "12.5"), None),  # a later board's
        (("BOOT", "1.4", "KF-B-1", "BROWNOUT"), BoardBooted("1.4", "KF-B-1", "BROWNOUT")),
    ):
        assert parse_report(report(*words), 5) == event


def test_a_heartbeat_carries_every_sensor_that_answers_and_of_the_others_nothing_is_known() -> None:
    sensors = ("TPROJ=41.5", "TCASE=12.25", "TBOARD=-3", "LEAK=1", "HUM=38.5", "DEPTH=12.5", "SUPPLY=11.9")
    got = parse_report(report("HB", "5000000", "300", "1", "0", *sensors), 77)
    assert got == Telemetry(77, 5_000_000, 300, LaserState(True, False), 41.5, 12.25, -3.0, True, 38.5, 11.9)
    got = parse_report(report("HB", "5000000", "300", "0", "1", "TPROJ=-", "LEAK=-"), 77)
    assert got == Telemetry(77, 5_000_000, 300, LaserState(False, True)), "a silent leak sensor is not a dry one"


@pytest.mark.parametrize(
    "bad",
    [
        report("PULSE", "64", "1", "1"),
        report("PULSE", "0", "4294967296", "1"),
        report("PULSE", "0", "1"),
        report("DONE", "many"),
        report("HB", "1", "2", "0", "2"),
        report("HB", "1", "2", "0", "0", "TPROJ=nan"),
        report("HB", "1", "2", "0", "0", "TPROJ=hot"),
        report("HB", "1", "2", "0", "0", "TPROJ"),
        report("HB", "1", "2", "0", "0", "=41"),
        report("DONE", "65"),
        report("BOOT", "1.4", "KF-B-1"),
        report("PULSE", "0", "1", "18446744073709551616"),
    ],
)
def test_a_report_that_cannot_be_is_refused(bad: Sentence) -> None:
    with pytest.raises(MalformedLine):
        parse_report(bad, 0)


def test_answers_are_taken_apart() -> None:
    info = parse_info(Sentence(Kind.ACKNOWLEDGE, 1, "INFO", ("1.4", "KF-B-1", "TPROJ+LEAK")))
    assert info.capabilities == {"TPROJ", "LEAK"}
    assert parse_info(Sentence(Kind.ACKNOWLEDGE, 1, "INFO", ("1.4", "KF-B-1", ""))).capabilities == frozenset()
    assert parse_lasers(Sentence(Kind.ACKNOWLEDGE, 1, "LASER", ("1", "0"))) == LaserState(True, False)
    for fields, told in ((("3", "armed", "since 12"), (3, "armed,since 12")), (("9999",), (9999, ""))):
        assert parse_refusal(Sentence(Kind.REFUSAL, 1, "ARM", fields)) == told
    with pytest.raises(MalformedLine):
        parse_refusal(Sentence(Kind.REFUSAL, 1, "ARM", ("10000",)))


@given(
    st.sampled_from(["PULSE", "DONE", "HB", "BOOT", "NOSYNC", "X"]),
    st.lists(st.one_of(st.text(max_size=12), st.sampled_from(["0", "1", "LEAK=1", "=", "9" * 5000])), max_size=8),
)
def test_arbitrary_fields_are_an_event_or_a_named_error(verb: str, fields: list[str]) -> None:
    for parse in (lambda s: parse_report(s, 0), parse_info, parse_lasers, parse_refusal):
        try:
            parse(report(verb, *fields))
        except MalformedLine:
            continue
