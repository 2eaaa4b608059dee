"""Names in the rig file become wires, or one clear error."""

import importlib
import threading
import time

import pytest

from drivers.api import DeviceRefused
from drivers.native import MonotonicClock
from drivers.registered_wires import REGISTERED
from drivers.rig import open_wires


def test_the_instruments_wires_are_the_systems_own() -> None:
    with open_wires("drivers.native:open", {}) as wires:
        assert wires.usb_backend is None
        assert callable(wires.hidraw.enumerate)
        assert abs(wires.clock.now_ns() - time.monotonic_ns()) < 50_000_000


@pytest.mark.parametrize(
    "name",
    ["drivers.native", ":open", "no.such.module:open", "drivers.native:NativeWires", "subprocess:Popen", "os:system"],
)
def test_a_name_that_is_not_registered_is_neither_imported_nor_called(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig file from somebody else must not be able to run anything."""
    asked: list[str] = []
    monkeypatch.setattr("importlib.import_module", asked.append)
    with pytest.raises(
        DeviceRefused, match=r"is not registered; allowed: drivers\.native:open, hw_sim\.wires:open"
    ) as caught:
        open_wires(name, {"args": ["touch", "/tmp/ran"]})
    assert "drivers.native:open" in caught.value.remedy
    assert asked == []


@pytest.mark.parametrize("name", REGISTERED)
def test_every_registered_name_is_a_function_that_is_there(name: str) -> None:
    module, _, function = name.partition(":")
    assert callable(getattr(importlib.import_module(module), function))


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
