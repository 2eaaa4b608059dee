"""The board's wire as pyserial sees it: URLs, timeouts in world time, and what ends a read."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial

from hw_sim import wires
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.test_board_firmware import framed

SPEED = 8.0
PING = framed("C,1,PING")


@pytest.fixture
def world() -> Iterator[World]:
    options = WorldOptions(world="serial", width_px=160, height_px=120, object="plane", idle_speed=SPEED)
    with World(options) as made, wires.open({"world": "serial"}):
        yield made


def port(timeout_s: float | None = 1.0, url: str = "kfsim://serial/board") -> Any:
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


def test_the_url_is_known_as_long_as_any_wires_are_open(world: World) -> None:
    with wires.open({"world": "serial"}):
        assert serial.protocol_handler_packages.count("hw_sim.wires") == 2
    with port() as p:
        assert p.is_open


def test_without_wires_there_is_no_such_protocol() -> None:
    with pytest.raises(ValueError, match="kfsim"):
        port()


@pytest.mark.parametrize("url", ["kfsim://nowhere/board", "kfsim://serial/camera", "kfsim://serial"])
def test_a_port_that_is_not_there_cannot_be_opened(world: World, url: str) -> None:
    with pytest.raises(serial.SerialException, match="No such file"):
        port(url=url)


def test_one_host_at_a_time_and_each_starts_with_an_empty_buffer(world: World) -> None:
    with port() as first:
        with pytest.raises(serial.SerialException, match="busy"):
            port()
        first.write(PING)
    with port(0.0) as second:
        assert second.in_waiting == 0
        assert second.read(100) == b""


def test_a_command_is_answered_through_the_whole_stack(world: World) -> None:
    with port() as p:
        assert p.write(PING) == len(PING)
        p.flush()
        line = p.read_until(b"\r\n")
        assert line.startswith(b"$A,1,PING,")
        p.write(framed("C,2,STOP"))
        assert p.in_waiting >= len(framed("A,2,STOP"))
        p.reset_input_buffer()
        assert p.in_waiting == 0


def test_a_timeout_counts_world_time_and_returns_what_there_is(world: World) -> None:
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


def test_a_silent_board_is_an_empty_read_and_no_error(world: World) -> None:
    world.fault("board off")
    with port(0.2) as p:
        p.write(PING)
        assert p.read(1) == b""


def test_cancel_read_ends_a_read_without_a_timeout(world: World) -> None:
    world.fault("board off")
    with port(None) as p:
        thread, results = in_background(lambda: p.read(1))
        p.cancel_read()
        thread.join(2.0)
        assert results == [b""]


def test_close_ends_a_read(world: World) -> None:
    world.fault("board off")
    p = port(None)
    thread, results = in_background(lambda: p.read(1))
    p.close()
    thread.join(2.0)
    assert isinstance(results[0], serial.SerialException)
    with pytest.raises(serial.SerialException):
        p.write(PING)
    p.close()
    port().close()  # free for the next


def test_the_end_of_the_world_is_a_vanished_port() -> None:
    options = WorldOptions(world="serial", width_px=160, height_px=120, object="plane")
    with wires.open({"world": "elsewhere", "width_px": 160, "height_px": 120, "object": "plane"}):
        with World(options) as made:
            made.fault("board off")
            p = port(None)
            thread, results = in_background(lambda: p.read(1))
        thread.join(2.0)
        assert isinstance(results[0], serial.SerialException)
        assert "returned no data" in str(results[0])
        with pytest.raises(serial.SerialException):
            p.write(PING)
        with pytest.raises(serial.SerialException):
            _ = p.in_waiting
        p.close()
