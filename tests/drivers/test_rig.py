"""Names in the rig file become wires, or one clear error."""

import threading
import time

import pytest

from drivers.api import DeviceRefused
from drivers.native import MonotonicClock
from drivers.rig import open_wires


def test_the_instruments_wires_are_the_systems_own() -> None:
    with open_wires("drivers.native:open", {}) as wires:
        assert wires.usb_backend is None
        assert callable(wires.hidraw.enumerate)
        assert abs(wires.clock.now_ns() - time.monotonic_ns()) < 50_000_000


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("drivers.native", "not of the form module:function"),
        (":open", "not of the form module:function"),
        ("no.such.module:open", "No module named 'no'"),
        ("drivers.native:opne", "no function opne"),
        ("drivers.native:NativeWires.x", "no function"),
    ],
)
def test_a_wrong_name_says_what_is_wrong_and_what_is_right(name: str, reason: str) -> None:
    with pytest.raises(DeviceRefused, match=reason) as caught:
        open_wires(name, {})
    assert "drivers.native:open" in caught.value.remedy


def test_the_instruments_wires_take_no_options() -> None:
    with pytest.raises(DeviceRefused, match="unknown options seed"), open_wires("drivers.native:open", {"seed": 1}):
        pass


def test_the_clock_waits_for_a_condition_or_the_timeout() -> None:
    clock = MonotonicClock()
    condition = threading.Condition()
    done: list[int] = []

    def finish() -> None:
        with condition:
            done.append(1)
            condition.notify_all()

    with condition:
        begin_ns = clock.now_ns()
        assert not clock.wait_for(condition, lambda: bool(done), 0.05)
        assert 0.045 < (clock.now_ns() - begin_ns) * 1e-9 < 0.5
        threading.Timer(0.05, finish).start()
        assert clock.wait_for(condition, lambda: bool(done), 5.0)
        assert (clock.now_ns() - begin_ns) * 1e-9 < 2.0
