"""What one heartbeat more or less changes: when a leak is believed, when the supply is low, when a laser is reported."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine.conditions import cleared, device_down, device_up, has, judge
from appliance.machine.states import Device, Machine
from appliance.scan.fault import FaultCode
from tests.appliance.machine.walks import SECOND_NS, aim, heartbeat


def supplied(machine: Machine, *volts: float | None) -> bool:
    """Whether the supply is told as low after these readings."""
    for supply_v in volts:
        machine = judge(machine, heartbeat(supply_v=supply_v).telemetry)
    return has(machine, FaultCode.SUPPLY_LOW)


@pytest.fixture
def machine() -> Machine:
    start = aim()
    return replace(start, settings=replace(start.settings, supply_low_v=10.0))


@pytest.mark.parametrize(
    ("volts", "low"),
    [
        ((10.0,), False),
        ((9.99,), True),
        ((10.2,), False),
        ((9.99, 10.2), True),
        ((9.99, 10.29), True),
        ((9.99, 10.3), False),
        ((9.99, 10.31), False),
        ((9.99, 10.31, 10.2), False),
        ((9.99, None), True),
        ((None,), False),
    ],
)
def test_a_low_supply_is_over_only_well_above_the_limit(
    machine: Machine, volts: tuple[float | None, ...], low: bool
) -> None:
    assert supplied(machine, *volts) == low


def test_without_a_limit_no_supply_is_low(machine: Machine) -> None:
    assert not supplied(replace(machine, settings=replace(machine.settings, supply_low_v=None)), 3.0)


@pytest.mark.parametrize(
    ("heartbeats", "believed"),
    [
        ((True,), False),
        ((True, True), True),
        ((True, False, True), False),
        ((True, None, True), False),
        ((True, True, False, False), True),
    ],
)
def test_water_is_believed_when_two_heartbeats_in_a_row_report_it_and_then_for_ever(
    machine: Machine, heartbeats: tuple[bool | None, ...], believed: bool
) -> None:
    for leak in heartbeats:
        machine = judge(machine, heartbeat(leak=leak).telemetry)
    assert has(machine, FaultCode.LEAK) == believed
    assert has(cleared(machine, FaultCode.LEAK), FaultCode.LEAK) == believed


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [(True, False, "left laser"), (False, True, "right laser"), (True, True, "left and right")],
)
def test_a_laser_that_conducts_is_reported_a_second_after_it_was_switched_off(
    machine: Machine, left: bool, right: bool, said: str
) -> None:
    beat = heartbeat(left_on=left, right_on=right).telemetry
    for since_s, told in ((0.99, False), (1.0, True)):
        off = replace(machine, lasers_off_since_ns=machine.now_ns - int(since_s * SECOND_NS))
        found = judge(off, beat)
        assert has(found, FaultCode.LASER_ON) == told
        if told:
            assert said in next(c.detail for c in found.conditions if c.code is FaultCode.LASER_ON)
            assert not has(judge(found, heartbeat().telemetry), FaultCode.LASER_ON)
    assert not has(judge(replace(machine, lasers_off_since_ns=None), beat), FaultCode.LASER_ON)


def test_a_device_is_up_or_lost_never_both(machine: Machine) -> None:
    device = next(iter(Device))
    down = device_down(machine, device, "unplugged", None)
    assert device not in down.up
    assert down.lost[device].detail == "unplugged"
    back = device_up(down, device)
    assert device in back.up
    assert device not in back.lost
