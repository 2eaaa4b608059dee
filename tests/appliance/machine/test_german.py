"""Every alert can be read in German as well as in English, within the same room."""

from __future__ import annotations

from dataclasses import replace
from string import Formatter

import pytest

from appliance.machine.alerts import LONGEST, RULES, alert_of
from appliance.machine.leading import alerts
from appliance.machine.states import Notice, NoticeKind, boot
from appliance.machine.words import Language
from appliance.scan.fault import Fault, FaultCode

NUMBERS = {
    "error_percent": 0.6,
    "received": 23.0, "expected": 24.0, "shift_px": 12.3, "coverage_percent": 100.0, "temperature_c": 61.4,
    "supply_v": 10.4, "distance_mm": 1437.0, "sight_m": 1.6,
}  # fmt: skip
DEVICES = (None, "camera.left", "camera.right", "cameras")


LONGEST_GERMAN = LONGEST[Language.GERMAN]
FIRST_KEPT = "ERSTER BLEIBT"


def test_every_fault_has_a_row_and_every_phrase_of_it_two_languages() -> None:
    assert set(RULES) == set(FaultCode)
    for code, rule in RULES.items():
        for words in (rule.headline, rule.action, rule.plain, rule.exchanged):
            assert words is None or (words.english and words.german), code


@pytest.mark.parametrize("code", list(FaultCode))
def test_both_languages_keep_to_the_room_with_and_without_numbers(code: FaultCode) -> None:
    for device in DEVICES:
        for numbers in ({}, NUMBERS):
            alert = alert_of(Fault(code, "detail", numbers, device))
            assert alert.german is not None
            for (headline, action), longest in (
                ((alert.headline, alert.action), LONGEST[Language.ENGLISH]),
                (alert.german, LONGEST_GERMAN),
            ):
                assert 0 < len(headline) <= longest, headline
                assert 0 < len(action) <= 32, action
                assert "{" not in headline


@pytest.mark.parametrize("code", list(FaultCode))
def test_both_languages_tell_the_same_numbers(code: FaultCode) -> None:
    def numbers_of(template: str) -> set[str]:
        return {name for _, name, _, _ in Formatter().parse(template) if name} - {"side", "window_side"}

    assert numbers_of(RULES[code].headline.german) == numbers_of(RULES[code].headline.english)


@pytest.mark.parametrize("code", list(FaultCode))
def test_nothing_is_cut_to_fit(code: FaultCode) -> None:
    """A template that is too long with real numbers would silently lose them."""
    for device in DEVICES[1:]:
        alert = alert_of(Fault(code, "detail", {**NUMBERS, "distance_mm": 437.0}, device))
        assert alert.german is not None
        said = {name for _, name, _, _ in Formatter().parse(RULES[code].headline.english) if name}
        if said - {"side", "window_side"}:
            assert any(letter.isdigit() for letter in alert.headline)
            assert any(letter.isdigit() for letter in alert.german[0])
        if said & {"side", "window_side"}:
            assert ("LINK" in alert.german[0]) == (device == "camera.left")
            assert ("RECHT" in alert.german[0]) == (device == "camera.right")


@pytest.mark.parametrize("kind", list(NoticeKind))
@pytest.mark.parametrize("code", list(FaultCode))
def test_a_notice_is_in_both_languages(code: FaultCode, kind: NoticeKind) -> None:
    fault = Fault(code, "detail", NUMBERS, "camera.right")
    said = alerts(replace(boot(0), notice=Notice(fault, kind)))[0]
    assert said.german is not None
    assert len(said.german[0]) <= LONGEST_GERMAN
    assert len(said.german[1]) <= LONGEST_GERMAN + len(f": {FIRST_KEPT}")
    assert said.german != (said.headline, said.action)
