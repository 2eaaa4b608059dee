"""One rule of liveness: progress within a limit, where progress is a message or processor time, and the latter counts for so long only."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from appliance.instrument.worker.child import Liveness
from tests.drivers.output.kernel import Time


@dataclass
class Patient:
    time: Time = field(default_factory=Time)
    used_s: float = 50.0
    """Processor time of a process; what it used before anything was owed counts for nothing."""

    def __post_init__(self) -> None:
        self.liveness = Liveness(self.time, lambda: self.used_s)

    def after(self, seconds: float, used_s: float = 0.0) -> str | None:
        self.time.sleep_s(seconds)
        self.used_s += used_s
        return self.liveness.late()


@pytest.fixture
def patient() -> Patient:
    return Patient()


def test_one_that_owes_nothing_is_never_late(patient: Patient) -> None:
    assert patient.after(3600.0) is None
    patient.liveness.owe(10.0, 60.0)
    patient.liveness.rest()
    assert patient.after(3600.0) is None
    assert patient.liveness.rested_s == 3600.0


def test_one_that_shows_nothing_is_late_after_its_limit_and_a_message_begins_it_anew(patient: Patient) -> None:
    for _ in range(20):
        patient.liveness.owe(10.0, 60.0)
        assert patient.after(9.9) is None
        assert patient.liveness.rested_s == 0.0
    assert patient.after(0.2) == "it sent nothing for 10 s"


@pytest.mark.parametrize(("used_s", "late"), [(0.11, False), (0.09, True)])
def test_a_twentieth_of_a_processor_is_progress(patient: Patient, used_s: float, late: bool) -> None:
    patient.liveness.owe(5.0, 60.0)
    assert patient.after(1.9) is None
    for _ in range(3):
        found = patient.after(2.0, used_s)
    assert (found is not None) == late


def test_who_only_computes_is_late_in_the_end(patient: Patient) -> None:
    patient.liveness.owe(10.0, 60.0)
    for _ in range(10):
        assert patient.after(6.0, 6.0) is None
    assert patient.after(0.1, 0.1) == "it computed for 60 s without a message"


def test_one_that_stops_computing_has_the_limit_from_then_on(patient: Patient) -> None:
    patient.liveness.owe(10.0, 60.0)
    assert patient.after(9.0, 9.0) is None
    assert patient.after(9.9) is None
    assert patient.after(0.2) is not None


def test_a_watchdog_gives_it_more(patient: Patient) -> None:
    patient.liveness.owe(10.0, 60.0)
    assert patient.after(10.1) is not None
    assert patient.liveness.late(5.0) is None
    patient.time.sleep_s(5.0)
    assert patient.liveness.late(5.0) is not None


def test_computing_is_told_once_and_by_looks_two_seconds_apart(patient: Patient) -> None:
    patient.liveness.owe(240.0, 240.0)
    patient.after(1.9, 1.9)
    assert not patient.liveness.computed(), "too short to tell"
    patient.after(0.1)
    assert patient.liveness.computed()
    assert not patient.liveness.computed(), "of the same time"
    patient.after(2.0)
    assert not patient.liveness.computed()
