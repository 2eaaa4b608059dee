"""The key pad's wire as hidapi's users see it: enumeration, blocking, unplugging."""

from __future__ import annotations

import inspect
import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import hidraw as hidapi
import pytest

from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.hidraw import HidrawModule
from hw_sim.world import World, WorldOptions
from tests.hw_sim.wires.test_board_serial import in_background

SPEED = 8.0


@pytest.fixture
def world() -> Iterator[World]:
    options = WorldOptions(world="hid", width_px=160, height_px=120, object="plane", idle_speed=SPEED)
    with World(options) as made:
        yield made


@pytest.fixture
def module(world: World) -> HidrawModule:
    return HidrawModule(world.keypad, world.time)


@contextmanager
def opened(module: HidrawModule) -> Iterator[Any]:
    device = module.device()
    device.open_path(module.enumerate(0x1209, 0x4B46)[0]["path"])
    try:
        yield device
    finally:
        device.close()


def test_it_is_enumerated_as_hidapi_does(module: HidrawModule) -> None:
    (found,) = module.enumerate(0x1209, 0x4B46)
    page = inspect.getdoc(hidapi.enumerate)
    assert page is not None
    documented = {line.strip("- '") for line in page.splitlines() if "- '" in line}
    assert len(documented) >= 10
    assert documented <= set(found)
    assert isinstance(found["path"], bytes)
    assert (found["vendor_id"], found["product_id"]) == (0x1209, 0x4B46)
    assert (found["usage_page"], found["usage"]) == (0xFF4B, 1)
    assert module.enumerate() == [found]
    assert module.enumerate(0x1209) == [found]
    assert module.enumerate(0x1209, 1) == []
    assert module.enumerate(1, 0x4B46) == []


def test_what_is_not_open_cannot_be_read(module: HidrawModule) -> None:
    """The same errors as the real module's, which is asked here too."""
    for maker in (module, hidapi):
        device = maker.device()
        with pytest.raises(ValueError, match="not open"):
            device.read(8, 10)
        with pytest.raises(OSError, match="open failed"):
            device.open_path(b"/dev/hidraw-none")
        device.close()
        device.close()


def test_open_by_numbers(module: HidrawModule) -> None:
    device = module.device()
    device.open(0x1209, 0x4B46)
    assert device.read(8, 1000)[0] == 1
    device.close()
    with pytest.raises(OSError, match="open failed"):
        device.open(0x1209, 0x4B46, "another")


def test_a_report_is_a_list_of_numbers_cut_to_what_was_asked_for(module: HidrawModule) -> None:
    with opened(module) as device:
        report = device.read(8, 1000)
        assert len(report) == 8
        assert all(type(value) is int for value in report)
        assert len(device.read(64, 1000)) == 8
        assert device.read(3, 1000)[0] == 1


def test_a_timeout_counts_world_time(world: World, module: HidrawModule) -> None:
    with opened(module) as device:
        device.read(8, 1000)
        begin_ns = world.time_ns
        assert device.read(8, 100) == []
        passed_s = (world.time_ns - begin_ns) / 1e9
    assert 0.1 <= passed_s <= 0.1 + 4 * BLANK_NS / 1e9


def test_without_a_timeout_a_read_waits_unless_told_not_to(module: HidrawModule) -> None:
    with opened(module) as device:
        assert device.read(8)[0] == 1
        assert device.set_nonblocking(1) == 0
        while device.read(8):
            pass
        assert device.read(8, 0) == []


def test_unplugging_ends_a_read_with_an_error_and_the_pad_returns_elsewhere(world: World, module: HidrawModule) -> None:
    (before,) = module.enumerate()
    with opened(module) as device:
        # Nothing would end this read but the unplugging: it waits for ever and reads all there is.
        def drain() -> None:
            while True:
                device.read(8)

        thread, results = in_background(drain)
        world.fault("keypad off")
        thread.join(2.0)
        (error,) = results
        assert isinstance(error, OSError)
        assert "read error" in str(error)
        assert module.enumerate() == []
        world.clear_faults()
        with pytest.raises(OSError, match="read error"):
            device.read(8, 1000)
    (after,) = module.enumerate()
    assert after["path"] != before["path"]
    with opened(module) as device:
        assert device.read(8, 1000)[0] == 1


def test_close_ends_a_read(module: HidrawModule) -> None:
    with opened(module) as device:
        ended = threading.Event()

        def drain() -> None:
            try:
                while True:
                    device.read(8)
            finally:
                ended.set()

        in_background(drain)
        device.close()
        assert ended.wait(2.0)


def test_when_nobody_reads_the_newest_reports_are_lost(world: World, module: HidrawModule) -> None:
    with opened(module) as device:
        world.time.sleep_s(20.0)
        counters = [report[2] for report in iter(lambda: device.read(8, 1), [])]
    assert len(counters) == 63, "20 s make 80 reports"
    assert {(b - a) % 256 for a, b in itertools.pairwise(counters)} == {1}
    # The oldest are the ones that are kept.
    with opened(module) as device:
        assert (device.read(8, 1000)[2] - counters[-1]) % 256 > 10
