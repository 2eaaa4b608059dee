"""A dive of a hundred scans stays inside its temperatures, as the page of warmth says."""

from __future__ import annotations

from appliance.instrument.machine.states import Settings, State
from bench.thermal.dive import Dive, dive_of

LIMITS = Settings().temperatures


def test_a_hundred_scans_in_warm_water_are_neither_warm_nor_refused() -> None:
    dive = dive_of(100, water_c=30.0)
    assert (dive.scans, sum(dive.refused.values())) == (100, 0)
    assert max(sample.case_c for sample in dive.samples) < LIMITS["case"].warm_c
    assert max(sample.projector_c for sample in dive.samples) < LIMITS["projector"].warm_c
    assert dive.samples[-1].projector_c > 30.0 + 15.0, "the housing does warm up"


def test_a_housing_that_cannot_cool_is_dark_before_it_switches_off() -> None:
    dive = Dive(50.0, "air", policy=False)  # the sun on deck, and somebody at the keys all the time
    dive.wait(40 * 60.0)
    assert State.COOLING in {sample.state for sample in dive.samples}
    first = next(sample for sample in dive.samples if sample.state is State.COOLING)
    assert not any(sample.lit for sample in dive.samples if sample.state is State.COOLING)
    assert max(sample.projector_c for sample in dive.samples) < LIMITS["projector"].off_c
    assert first.case_c >= LIMITS["case"].hot_c - 1.0 or first.projector_c >= LIMITS["projector"].hot_c - 1.0
