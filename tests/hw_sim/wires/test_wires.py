"""The library ends of the wires: pyserial and hidapi find their devices and wait in world time; names lead to worlds."""

from __future__ import annotations

import inspect
import os
import select
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hidraw as hidapi
import pytest
import serial

from hw_sim import wires
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires import open as open_wires
from hw_sim.wires.hidraw import HidrawModule
from hw_sim.wires.umockdev.hidraw_node import HidFile, PluggedPad
from hw_sim.wires.umockdev.readiness import Readiness
from hw_sim.world import World, WorldOptions
from tests.hw_sim.conftest import SMALL, Bench
from tests.hw_sim.devices.host import framed

RIGS = Path(wires.__file__).parents[1] / "rigs"
PING = framed("C,1,PING")


@pytest.fixture
def world() -> Iterator[World]:
    with World(WorldOptions(world="fast", idle_speed=8.0, **SMALL)) as made, open_wires({"world": "fast"}):
        yield made


def port(timeout_s: float | None = 1.0, url: str = "kfsim://fast/board") -> Any:
    return serial.serial_for_url(url, timeout=timeout_s)


def in_background(act: Callable[[], object]) -> tuple[threading.Thread, list[object]]:
    """Run it in a thread that is surely waiting by now; its result or exception is appended."""
    results: list[object] = []

    def run() -> None:
        try:
            results.append(act())
        except Exception as error:
            results.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(0.05)
    assert thread.is_alive(), results
    return thread, results


def test_one_host_at_a_time_while_wires_are_open_and_each_starts_with_an_empty_buffer() -> None:
    with open_wires({**SMALL, "world": "fast"}), open_wires({"world": "fast"}):
        with port() as first:
            with pytest.raises(serial.SerialException, match="busy"):
                port()
            assert first.write(PING) == len(PING)
            assert first.read_until(b"\r\n").startswith(b"$A,1,PING,")
            first.write(PING)
        with port(0.0) as second:
            assert second.read(100) == b""
    with pytest.raises(ValueError, match="kfsim"):
        port()


def test_a_timeout_of_the_port_counts_world_time_and_returns_what_there_is(world: World) -> None:
    world.fault("board slow")
    with port(1.0) as p:
        p.write(PING)
        begin_ns, begin_real_ns = world.time_ns, time.monotonic_ns()
        got = p.read(10_000)
        passed_s = (world.time_ns - begin_ns) / 1e9
        real_s = (time.monotonic_ns() - begin_real_ns) / 1e9
    assert 1.0 <= passed_s <= 1.0 + 4 * BLANK_NS / 1e9
    assert real_s < 1.0, "the world is faster than its host"
    assert b"$A,1,PING," in got, "the answer of 500 ms is in it"


@pytest.mark.parametrize("by", ["cancel_read", "close", "the world's end"])
def test_a_read_without_a_timeout_can_be_ended(by: str) -> None:
    with open_wires({**SMALL, "world": "elsewhere"}):
        with World(WorldOptions(world="fast", **SMALL)) as world:
            world.fault("board off")
            p = port(None)
            thread, results = in_background(lambda: p.read(1))
            if by != "the world's end":
                getattr(p, by)()
                thread.join(2.0)
        thread.join(2.0)
        if by == "cancel_read":
            assert results == [b""]
        else:
            assert isinstance(results[0], serial.SerialException)
        with pytest.raises(serial.SerialException):
            p.write(PING)


def test_the_pad_is_enumerated_and_refused_as_by_hidapi(world: World) -> None:
    module = HidrawModule(world.keypad, world.time)
    (found,) = module.enumerate(0x1209, 0x4B46)
    page = inspect.getdoc(hidapi.enumerate) or ""
    documented = {line.strip("- '") for line in page.splitlines() if "- '" in line}
    assert len(documented) >= 10
    assert documented <= set(found)
    assert isinstance(found["path"], bytes)
    assert (found["vendor_id"], found["product_id"]) == (0x1209, 0x4B46)
    assert (found["usage_page"], found["usage"]) == (0xFF4B, 1)
    for which, there in (((), [found]), ((0x1209,), [found]), ((0x1209, 1), []), ((1, 0x4B46), [])):
        assert module.enumerate(*which) == there
    for maker in (module, hidapi):
        device = maker.device()
        with pytest.raises(ValueError, match="not open"):
            device.read(8, 10)
        with pytest.raises(OSError, match="open failed"):
            device.open_path(b"/dev/hidraw-none")


def test_reads_of_the_pad_wait_in_world_time_until_it_is_unplugged(world: World) -> None:
    module = HidrawModule(world.keypad, world.time)
    device = module.device()
    before = module.enumerate()[0]["path"]
    device.open_path(before)
    report = device.read(8, 1000)
    assert [type(value) for value in report] == [int] * 8
    begin_ns = world.time_ns
    assert device.read(8, 100) == []
    assert 0.1 <= (world.time_ns - begin_ns) / 1e9 <= 0.1 + 4 * BLANK_NS / 1e9
    world.time.sleep_s(20.0)
    counters = [report[2] for report in iter(lambda: device.read(8, 1), [])]
    assert counters == [(counters[0] + k) % 256 for k in range(63)], "20 s make 80 reports; the newest are lost"

    # Nothing would end this read but the unplugging: it waits for ever and reads all there is.
    def drain() -> None:
        while True:
            device.read(8)

    thread, results = in_background(drain)
    world.fault("keypad off")
    thread.join(2.0)
    assert isinstance(results[0], OSError)
    assert module.enumerate() == []
    world.clear_faults()
    with pytest.raises(OSError, match="read error"):
        device.read(8, 1000)
    assert module.enumerate()[0]["path"] != before


def test_a_node_of_the_pad_gives_one_report_a_read_cut_to_what_was_asked_for(world: World, tmp_path: Path) -> None:
    file = HidFile(PluggedPad(world.keypad, world.time, Readiness(tmp_path / "hidraw0")))
    reports = [file.read(size) for size in (64, 5)]
    assert [len(report) for report in reports] == [8, 5]
    assert reports[1][2] == (reports[0][2] + 1) % 256, "each counts on"


@pytest.mark.parametrize(("mode", "wanted"), [(os.O_RDONLY, select.POLLIN), (os.O_WRONLY, select.POLLOUT)])
def test_who_waits_for_a_node_that_goes_finds_it_ready(mode: int, wanted: int, tmp_path: Path) -> None:
    ready, waiting = Readiness(tmp_path / "node", for_writing=mode == os.O_WRONLY), select.poll()
    node = os.open(tmp_path / "node", mode | os.O_NONBLOCK)
    waiting.register(node, wanted)
    assert waiting.poll(0) == []
    ready.close()
    assert waiting.poll(0)[0][1] & wanted
    os.close(node)


def test_a_world_that_was_refused_is_not_found_by_the_next_who_asks_for_its_name() -> None:
    """It was, and its time stood still: whoever waited for one of its devices waited for ever."""
    for wrong, named in (({"faults": ["camera.left explode"]}, "explode"), ({"script": "dive.txt"}, "status")):
        with pytest.raises(ValueError, match=named), open_wires({**SMALL, **wrong}):
            pass
    with open_wires(SMALL) as next_wires:
        start_ns = next_wires.clock.now_ns()
        time.sleep(0.1)
        assert next_wires.clock.now_ns() - start_ns > 50_000_000, "its time passes"


def test_a_world_that_fails_says_so(make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()

    def broken(*_: object) -> None:
        raise ZeroDivisionError("no light")

    monkeypatch.setattr(bench.world._renderer, "expose", broken)
    bench.camera()
    bench.board.ask("LIVE", 1, 500, 8000)
    deadline_s = time.monotonic() + 5
    while not bench.world.time.closed and time.monotonic() < deadline_s:
        bench.wires.clock.sleep_s(0.01)
    with pytest.raises(ZeroDivisionError, match="no light"):
        bench.close()


@pytest.mark.parametrize("name", ["full", "small"])
def test_the_simulated_rigs_differ_from_the_instrument_only_in_what_is_simulated(name: str) -> None:
    instrument = tomllib.loads((RIGS.parents[1] / "appliance" / "store" / "rigs" / "kingfisher.toml").read_text())
    rig = tomllib.loads((RIGS / f"{name}.toml").read_text())
    assert rig["rig"]["wires"] == "hw_sim.wires:open"
    assert rig["board"]["url"] == "kfsim://main/board"
    differing = {
        f"{table}.{key}"
        for table, values in instrument.items()
        for key, value in values.items()
        if rig[table].get(key) != value and not isinstance(value, dict)
    }
    allowed = {"rig.name", "rig.serial", "rig.wires", "board.url", "storage.root"}
    assert differing - allowed <= ({"design.pixel_um"} if name == "small" else set())
    options = rig["rig"].get("wires_options", {})
    for camera in (rig["camera"][side] for side in ("left", "right")):
        sides = (camera["width_px"], camera["height_px"])
        assert sides == (options.get("width_px", 1600), options.get("height_px", 1200))
        assert camera["width_px"] * rig["design"]["pixel_um"] == pytest.approx(1600 * 4.5)
