"""The table of alerts against what the operator's pages promise: which words, how grave, and what a fault costs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from appliance.machine.alerts import RULES, Severity, alert_of
from appliance.scan.fault import Fault, FaultCode
from tests.appliance.machine.test_german import NUMBERS
from tests.appliance.machine.test_what_faults_do import HEAT_AND_WATER, NEEDED, NOWHERE_TO_KEEP, WITNESSES

PAGES = Path(__file__).parents[3] / "docs" / "operator"
SEVERITIES = {
    "Critical": Severity.CRITICAL, "Warning": Severity.WARNING, "For": Severity.INFO,
    "Kritisch": Severity.CRITICAL, "Warnung": Severity.WARNING, "Zur": Severity.INFO,
}  # fmt: skip
LEFT = "camera.left"


def without_numbers(text: str) -> str:
    """Numbers are examples, and so are their widths."""
    return re.sub(r"\d+([.,]\d+)?", "#", text)


def rows(language: str) -> set[tuple[Severity, str, str]]:
    """Gravity, headline and action of every row of a page."""
    found: set[tuple[Severity, str, str]] = set()
    severity: Severity | None = None
    for line in (PAGES / f"alarms.{language}.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            # Words that are no messages have a section of their own.
            severity = SEVERITIES.get(re.split(r"\W", line[3:])[0])
        elif severity is not None and line.startswith("| **"):
            _, headline, _, action, *_ = (cell.strip() for cell in line.split("|"))
            found.add((severity, without_numbers(headline.strip("*")), action))
    return found


@pytest.mark.parametrize("code", list(FaultCode))
def test_a_message_says_what_the_operators_pages_say(code: FaultCode) -> None:
    known = {language: rows(language) for language in ("en", "de")}
    for device in (None, LEFT):
        alert = alert_of(Fault(code, "", NUMBERS, device))
        assert alert.german is not None
        english = alert.severity, without_numbers(alert.headline), alert.action
        german = alert.severity, without_numbers(alert.german[0]), alert.german[1]
        if english in known["en"]:
            assert german in known["de"]
            return
    raise AssertionError(f"{code} is not on the page as {english}")


def codes(flag: str) -> set[FaultCode]:
    return {code for code, rule in RULES.items() if getattr(rule, flag)}


def test_what_a_fault_costs_is_what_the_faults_of_its_kind_cost() -> None:
    assert codes("stops_capture") == NEEDED
    assert codes("forbids_light") == HEAT_AND_WATER
    assert codes("blocks_scan") == NEEDED | HEAT_AND_WATER | NOWHERE_TO_KEEP | {FaultCode.SUPPLY_LOW}
    assert codes("spoils_scan") == WITNESSES
    assert codes("doubts_lengths") == {FaultCode.UNCALIBRATED, FaultCode.LENGTH_ERROR, FaultCode.VERIFY_CALIBRATION}
    assert codes("passing") == {FaultCode.AIM_DARK, FaultCode.AIM_TURBID, FaultCode.AIM_LIGHT, FaultCode.AIM_FAST}


def test_an_alert_is_neither_lasting_nor_known_before_somebody_says_so() -> None:
    alert = alert_of(Fault(FaultCode.UNCALIBRATED))
    assert (alert.lasts, alert.seen, alert.passing) == (False, False, False)
