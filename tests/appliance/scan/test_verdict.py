"""A fault by itself is a verdict that was not passed, with the fault's own numbers and words."""

from __future__ import annotations

from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Verdict


def test_a_fault_is_stored_as_a_verdict_that_was_not_passed() -> None:
    fault = Fault(
        FaultCode.FRAME_MISSING, "23 of 24 frames arrived", {"received": 23.0, "expected": 24.0}, "camera.left"
    )
    told = Verdict("ledger", False, {"received": 23.0, "expected": 24.0}, "FRAME_MISSING: 23 of 24 frames arrived")
    assert Verdict.failed("ledger", fault) == told
    assert Verdict.failed("ledger", Fault(FaultCode.LEAK)).text == "LEAK", "no colon with nothing behind it"


def test_faults_of_one_kind_with_other_numbers_are_two_faults() -> None:
    one, two = (Fault(FaultCode.FRAME_MISSING, "", {"received": received}) for received in (22.0, 23.0))
    assert len({one, two, Fault(FaultCode.FRAME_MISSING, "", {"received": 23.0})}) == 2
