"""Names in the rig file become wires, or one clear error."""

from __future__ import annotations

import importlib
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.api import ClockReading, DeviceGone, DeviceRefused
from drivers.native import MonotonicClock
from drivers.output.display import PictureDisplay
from drivers.output.projector import PatternProjector
from drivers.registered_wires import REGISTERED
from drivers.rig import (
    BoardSpec,
    CameraSpec,
    KeysSpec,
    OutputKind,
    OutputSpec,
    open_board,
    open_camera,
    open_keys,
    open_outputs,
    open_wires,
)
from tests.drivers.board.test_board import FarEnd
from tests.drivers.camera.scripted import Bus, ScriptedCamera
from tests.drivers.clock import SteppedClock
from tests.drivers.keys.test_keypad import NONE, Pad, report
from tests.drivers.output.kernel import KernelWires, Plug, mode, plugged


def test_the_instruments_wires_are_the_systems_own() -> None:
    with open_wires("drivers.native:open", {}) as wires:
        assert wires.usb_backend is None
        assert callable(wires.hidraw.enumerate)
        with pytest.raises(DeviceGone, match="no-such-card"):
            wires.open_card("/dev/no-such-card")
        assert time.monotonic_ns() <= wires.clock.now_ns() <= time.monotonic_ns()
    with pytest.raises(DeviceRefused, match="unknown options seed"), open_wires("drivers.native:open", {"seed": 1}):
        pass


@pytest.mark.parametrize(
    "name",
    ["drivers.native", ":open", "no.such.module:open", "drivers.native:NativeWires", "subprocess:Popen", "os:system"],
)
def test_a_name_that_is_not_registered_is_neither_imported_nor_called(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig file from somebody else must not be able to run anything."""

    def missing(module: str) -> Any:
        raise ImportError(f"No module named {module!r}")

    monkeypatch.setattr("drivers.rig.importlib", SimpleNamespace(import_module=missing))
    said = r"is not registered; allowed: drivers\.native:open, hw_sim\.wires:open"
    with pytest.raises(DeviceRefused, match=said) as caught:
        open_wires(name, {"args": ["touch", "/tmp/ran"]})
    assert "drivers.native:open" in caught.value.remedy
    with pytest.raises(DeviceRefused, match=r"'hw_sim\.wires:open': No module named 'hw_sim\.wires'") as caught:
        open_wires("hw_sim.wires:open", {})  # registered, and not installed
    assert caught.value.device == "wires"


@pytest.mark.parametrize("name", REGISTERED)
def test_every_registered_name_is_a_function_that_is_there(name: str) -> None:
    module, _, function = name.partition(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_a_clock_sleeps_as_long_as_it_is_told_and_waits_for_a_condition(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    for duration_s in (0.25, 0.0, -1.0, 3.0):
        MonotonicClock().sleep_s(duration_s)
    assert slept == [0.25, 3.0]
    condition = threading.Condition()
    monkeypatch.setattr(condition, "wait_for", lambda predicate, timeout_s: predicate() and timeout_s == 0.5)
    assert MonotonicClock().wait_for(condition, lambda: True, 0.5)
    assert not MonotonicClock().wait_for(condition, lambda: False, 0.5)


def wired(clock: Any, **parts: Any) -> Any:
    return SimpleNamespace(clock=clock, **parts)


def test_each_device_is_opened_on_the_wires() -> None:
    clock = SteppedClock()
    bus = Bus(ScriptedCamera(clock))
    with open_camera(CameraSpec("camera.left", "KF-CAM-L"), wired(clock, usb_backend=bus)) as camera:
        assert camera.identity.serial == "KF-CAM-L"
        clock_of = ClockReading(camera_time_ns=1_000, host_sent_ns=5_000, host_received_ns=5_600)
        assert (clock_of.bracket_ns, clock_of.offset_ns) == (600, 4_300), "in the middle of the question"
    pad = Pad(clock)
    pad.queue(0, report(NONE, 0, 0))
    with open_keys(KeysSpec(0x1209, 0x4B46), wired(clock, hidraw=pad)) as keys:
        assert keys.health().ok
    far = FarEnd()
    with open_board(BoardSpec(far.url), wired(MonotonicClock())) as board:
        assert board.vsync().count == 300
    far.unplug()
    card = "/dev/dri/card0"
    kernel = plugged(Plug(1, 11, 1, [mode(128, 96)]), Plug(2, 10, 1, [mode(80, 48)]))
    projector = OutputSpec(OutputKind.KMS, card, "HDMI-A-1", 128, 96, 60.0)
    display = OutputSpec(OutputKind.KMS, card, "DP-1", 80, 48, 60.0)
    with open_outputs(projector, display, KernelWires({card: [kernel]})) as outputs:  # type: ignore[arg-type]
        lit: tuple[PatternProjector[Any], PictureDisplay[Any]] = outputs.open_projector(), outputs.open_display()
        assert [one.size_px for one in lit] == [(128, 96), (80, 48)]
