"""A block goes through the pipe as leader, payload and trailer, in transfers that end as bulk transfers end; and when cameras expose."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest
import usb.core

from hw_sim.devices.u3v_stream import Block, Overflow, Region, Setup, StreamPipe
from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import GotFrame

PACKET = 1024
WHOLE = Setup(52, 32, 4 * PACKET, 1, 0, 0)


def read(pipe: StreamPipe, length: int) -> bytes:
    buffer = bytearray(length)
    filled, _ = pipe.read(memoryview(buffer), PACKET)
    return bytes(buffer[:filled])


def gaps_ms(frames: list[GotFrame]) -> list[float]:
    return list(np.diff([f.time_ns for f in frames]) / 1e6)


def test_leader_and_trailer_say_what_the_standard_says() -> None:
    b = Block(7, 1234, Region(160, 120, 8, 2), bytes(160 * 120))
    leader = struct.unpack("<4sHHQHHQI4I4x", b.leader())
    assert leader == (b"U3VL", 0, 52, 7, 0, 1, 1234, 0x01080001, 160, 120, 8, 2)
    assert struct.unpack("<4sHHQHHQI", b.trailer()) == (b"U3VT", 0, 32, 7, 0, 0, 160 * 120, 120)


@pytest.mark.parametrize(
    ("size", "setup", "asked", "got"),
    [
        pytest.param(4 * PACKET, WHOLE, [4 * PACKET], [4 * PACKET], id="fits exactly"),
        pytest.param(1500, WHOLE, [4 * PACKET], [1500], id="short packet"),
        pytest.param(2 * PACKET, WHOLE, [4 * PACKET], [2 * PACKET], id="empty packet"),
        pytest.param(3172, Setup(52, 32, PACKET, 2, PACKET, 104), [PACKET] * 3 + [104], [PACKET] * 3 + [100], id="cut"),
        pytest.param(4 * PACKET, WHOLE, [PACKET, 3 * PACKET], [PACKET, 3 * PACKET], id="pieces"),
    ],
)
def test_transfers_end_with_a_short_packet_and_no_other(
    size: int, setup: Setup, asked: list[int], got: list[int]
) -> None:
    pipe, payload = StreamPipe(), bytes(k % 251 for k in range(size))
    pipe.send(Block(7, 1234, Region(size, 1, 0, 0), payload), setup)
    with pytest.raises(Overflow):
        read(pipe, 40)
    assert len(read(pipe, 52)) == 52
    parts = [read(pipe, length) for length in asked]
    assert [len(part) for part in parts] == got
    assert b"".join(parts) == payload
    assert read(pipe, 32)[:4] == b"U3VT"
    assert (read(pipe, 32), pipe.blocks) == (b"", 0)


@pytest.mark.parametrize(
    ("every", "trigger", "exposure_us"),
    [
        pytest.param(2, True, 8000, id="each pulse"),
        pytest.param(1, False, 8000, id="at its own rate, whatever the line does"),
        pytest.param(1, True, 25_000, id="every second pulse: it exposes yet"),
    ],
)
def test_frames_count_up_and_carry_the_cameras_time(bench: Bench, every: int, trigger: bool, exposure_us: int) -> None:
    camera = bench.camera(trigger=trigger, exposure_us=exposure_us)
    if trigger:
        with pytest.raises(usb.core.USBTimeoutError):
            camera.frame(100, bench.size)
    bench.board.ask("LIVE", every, 500, 8000)
    frames = [camera.frame(1000, bench.size) for _ in range(5)]
    assert gaps_ms(frames) == pytest.approx([33.333] * 4, abs=0.01)
    assert [f.block_id for f in frames] == list(range(5)), "what was ignored has no number"
    assert all(f.image.shape == (120, 160) and f.status == 0 and f.valid == bench.size for f in frames)


def test_software_trigger_and_single_frame(bench: Bench) -> None:
    camera = bench.camera()
    camera.put(0x200204, 8)
    camera.put(0x20020C, 1)
    assert camera.frame(500, bench.size).block_id == 0
    for register, value in ((0x200108, 1), (0x200100, 1), (0x200104, 1), (0x20020C, 1), (0x20020C, 1)):
        camera.put(register, value)
    assert [f.block_id for f in bench.drain(camera)] == [0], "each acquisition counts from 0, and this one is over"


def test_a_host_that_does_not_read_gets_an_overrun_and_then_a_gap(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(idle_speed=4.0)
    camera = bench.camera()
    bench.board.ask("LIVE", 1, 500, 8000)
    bench.wires.clock.sleep_s(1.2)
    bench.board.ask("STOP")
    bench.wires.clock.sleep_s(0.1)  # what is being exposed finds no room either
    *whole, lost = bench.drain(camera)
    assert [(f.block_id, f.status) for f in whole] == [(k, 0) for k in range(32)], "nothing is overwritten"
    assert (lost.block_id, lost.status, lost.payload, lost.valid) == (32, 0xA101, b"", 0)
    bench.board.ask("LIVE", 1, 500, 8000)
    assert camera.frame(500, bench.size).block_id > 52, "block ids count exposures"


@pytest.mark.parametrize(("at_end", "later_ms"), [(0, 0.0), (1, 8.0)])
def test_a_stamp_is_the_time_of_the_exposures_start_or_of_its_end(
    make_bench: Callable[..., Bench], at_end: int, later_ms: float
) -> None:
    """Pulses come regularly; an exposure that gets 8 ms longer ends so much later, and begins when it did."""
    bench = make_bench(outside={"clocks": {"stamps_at_end": at_end}})
    camera = bench.camera(exposure_us=4000)
    bench.board.ask("LIVE", 2, 500, 8000)
    first = camera.frame(1000, bench.size)
    camera.put(0x200304, 12_000)
    last = [camera.frame(1000, bench.size) for _ in range(3)][-1]
    gap_ms = (last.time_ns - first.time_ns) / 1e6
    assert gap_ms - 100.0 * round(gap_ms / 100.0) == pytest.approx(later_ms, abs=0.02)


def test_exposures_that_jitter_begin_after_their_pulse(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(outside={"clocks": {"camera_jitter_us": 200.0}})
    camera = bench.camera()
    bench.board.ask("LIVE", 2, 500, 8000)
    late_us = np.array(gaps_ms([camera.frame(1000, bench.size) for _ in range(30)])) * 1000 - 33_333.3
    assert 150.0 < late_us.std() < 450.0, "√2 times 200 µs"
    assert abs(late_us.mean()) < 100.0
