"""A block goes through the pipe as leader, payload and trailer, in transfers that end as bulk transfers end."""

from __future__ import annotations

import array
import itertools
import struct
from collections.abc import Callable

import numpy as np
import pytest
import usb.core

from hw_sim.devices.u3v_stream import Block, Overflow, Region, Setup, StreamPipe
from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import U3vHost, greys

PACKET = 1024


def block(size: int) -> Block:
    return Block(7, 1234, Region(size, 1, 0, 0), bytes(k % 251 for k in range(size)))


def setup(size: int, count: int = 1, final1: int = 0, final2: int = 0) -> Setup:
    return Setup(52, 32, size, count, final1, final2)


def read(pipe: StreamPipe, length: int) -> tuple[bytes, bool]:
    buffer = bytearray(length)
    filled, done = pipe.read(memoryview(buffer), PACKET)
    return bytes(buffer[:filled]), done


def test_leader_and_trailer_say_what_the_standard_says() -> None:
    b = Block(7, 1234, Region(160, 120, 8, 2), bytes(160 * 120))
    magic, zero, size, block_id, zero2, kind, time_ns, pixel = struct.unpack_from("<4sHHQHHQI", b.leader())
    assert (magic, zero, size, block_id, zero2, kind, time_ns, pixel) == (b"U3VL", 0, 52, 7, 0, 1, 1234, 0x01080001)
    assert struct.unpack_from("<5I", b.leader(), 32)[:4] == (160, 120, 8, 2)
    assert len(b.leader()) == 52
    assert struct.unpack("<4sHHQHHQI", b.trailer()) == (b"U3VT", 0, 32, 7, 0, 0, 160 * 120, 120)


def test_a_transfer_that_fits_exactly_has_no_empty_packet_behind_it() -> None:
    pipe = StreamPipe()
    pipe.send(block(4 * PACKET), setup(4 * PACKET))
    assert len(read(pipe, 52)[0]) == 52
    assert read(pipe, 4 * PACKET) == (bytes(k % 251 for k in range(4 * PACKET)), True)
    assert read(pipe, 32)[0][:4] == b"U3VT"
    assert read(pipe, 32) == (b"", False)
    assert pipe.blocks == 0


def test_a_short_packet_ends_the_hosts_transfer() -> None:
    pipe = StreamPipe()
    pipe.send(block(1500), setup(4 * PACKET))
    read(pipe, 52)
    data, done = read(pipe, 4 * PACKET)
    assert (len(data), done) == (1500, True)


def test_an_empty_packet_ends_a_transfer_that_could_be_longer() -> None:
    pipe = StreamPipe()
    pipe.send(block(2 * PACKET), setup(4 * PACKET))
    read(pipe, 52)
    data, done = read(pipe, 4 * PACKET)
    assert (len(data), done) == (2 * PACKET, True)
    assert read(pipe, 32)[0][:4] == b"U3VT"


def test_a_payload_may_be_cut_into_several_transfers() -> None:
    pipe = StreamPipe()
    pipe.send(block(3 * PACKET + 100), setup(PACKET, count=2, final1=PACKET, final2=104))
    read(pipe, 52)
    assert [len(read(pipe, n)[0]) for n in (PACKET, PACKET, PACKET, 104)] == [PACKET, PACKET, PACKET, 100]
    assert read(pipe, 32)[0][:4] == b"U3VT"


def test_a_buffer_smaller_than_a_packet_overflows() -> None:
    pipe = StreamPipe()
    pipe.send(block(4 * PACKET), setup(4 * PACKET))
    with pytest.raises(Overflow):
        read(pipe, 40)


def test_a_buffer_of_whole_packets_takes_what_fits() -> None:
    pipe = StreamPipe()
    pipe.send(block(4 * PACKET), setup(4 * PACKET))
    read(pipe, 52)
    assert read(pipe, PACKET) == (bytes(k % 251 for k in range(PACKET)), True)
    assert len(read(pipe, 3 * PACKET)[0]) == 3 * PACKET


# ---------------------------------------------------------------------------------------------- on the wire


def test_triggered_frames_count_up_and_carry_the_cameras_time(bench: Bench) -> None:
    camera = bench.camera()
    bench.board.ask("LIVE", 2, 500, 8000)
    frames = [camera.frame(1000, bench.size) for _ in range(6)]
    assert [f.block_id for f in frames] == list(range(6))
    gaps_ms = [(b.time_ns - a.time_ns) / 1e6 for a, b in itertools.pairwise(frames)]
    assert gaps_ms == pytest.approx([33.333] * 5, abs=0.01)
    assert all(f.image.shape == (120, 160) and f.status == 0 and f.valid == bench.size for f in frames)


def test_without_trigger_mode_the_camera_runs_freely_and_ignores_the_line(bench: Bench) -> None:
    camera = bench.camera(trigger=False)
    bench.board.ask("LIVE", 1, 500, 8000)
    frames = [camera.frame(1000, bench.size) for _ in range(5)]
    gaps_ms = [(b.time_ns - a.time_ns) / 1e6 for a, b in itertools.pairwise(frames)]
    assert gaps_ms == pytest.approx([33.333] * 4, abs=0.01), "its own frame rate"


def test_with_trigger_mode_nothing_comes_untriggered(bench: Bench) -> None:
    camera = bench.camera()
    with pytest.raises(usb.core.USBTimeoutError):
        camera.frame(200, bench.size)


def test_a_trigger_while_exposing_is_ignored(bench: Bench) -> None:
    camera = bench.camera(exposure_us=25_000)
    bench.board.ask("LIVE", 1, 500, 8000)
    frames = [camera.frame(1000, bench.size) for _ in range(5)]
    gaps_ms = [(b.time_ns - a.time_ns) / 1e6 for a, b in itertools.pairwise(frames)]
    assert gaps_ms == pytest.approx([33.333] * 4, abs=0.01), "every second one"
    assert [f.block_id for f in frames] == list(range(5)), "what was ignored has no number"


def test_the_width_of_the_pulse_is_the_exposure_if_asked_for(bench: Bench) -> None:
    """Twice the exposure is twice the light; so is doubling the time in mode Timed."""
    projector = bench.projector()
    projector.show(projector.buffer(greys([120])[0]))
    camera = bench.camera(exposure_us=3_000)
    means = []
    for mode, width_us in ((1, 9_000), (2, 3_000), (2, 6_000)):
        camera.put(0x200300, mode)
        bench.board.ask("LIVE", 6, 500, width_us)
        camera.frame(1000, bench.size)
        means.append(float(camera.frame(1000, bench.size).image.mean()))
        bench.board.ask("STOP")
        drain(camera, bench)
    assert means[1] == pytest.approx(means[0], rel=0.05)
    assert means[2] == pytest.approx(2 * means[0], rel=0.15)


def drain(camera: U3vHost, bench: Bench) -> None:
    while True:
        try:
            camera.frame(100, bench.size)
        except usb.core.USBTimeoutError:
            return


def test_software_trigger_and_single_frame(bench: Bench) -> None:
    camera = bench.camera()
    camera.put(0x200204, 8)
    camera.put(0x20020C, 1)
    assert camera.frame(500, bench.size).block_id == 0
    camera.put(0x200108, 1)
    camera.put(0x200100, 1)
    camera.put(0x200104, 1)
    camera.put(0x20020C, 1)
    assert camera.frame(500, bench.size).block_id == 0, "each acquisition counts from 0"
    camera.put(0x20020C, 1)
    with pytest.raises(usb.core.USBTimeoutError):
        camera.frame(200, bench.size)


def test_a_region_is_read_from_where_it_lies(bench: Bench) -> None:
    projector = bench.projector()
    projector.show(projector.buffer(greys([120])[0]))
    whole = bench.camera("left")
    bench.board.ask("LIVE", 6, 500, 8000)
    full = whole.frame(1000, bench.size).image.astype(float)
    bench.board.ask("STOP")
    drain(whole, bench)
    whole.put(0x200108, 1)
    whole.put(whole.sirm + 4, 0)
    for register, value in ((0x200000, 80), (0x200004, 60), (0x200008, 40), (0x20000C, 30)):
        whole.put(register, value)
    whole.set_up_stream()
    whole.put(0x200104, 1)
    bench.board.ask("LIVE", 6, 500, 8000)
    part = whole.frame(1000, 80 * 60)
    assert struct.unpack_from("<4I", part.leader, 32) == (80, 60, 40, 30)
    inside, elsewhere = full[30:90, 40:120], full[:60, :80]
    assert abs(part.image - inside).mean() < 0.5 * abs(part.image - elsewhere).mean()


def test_nothing_is_streamed_while_the_stream_is_off(bench: Bench) -> None:
    camera = bench.camera()
    bench.board.ask("LIVE", 1, 500, 8000)
    camera.frame(1000, bench.size)
    camera.put(camera.sirm + 4, 0)
    with pytest.raises(usb.core.USBTimeoutError):
        camera.frame(200, bench.size)
    camera.set_up_stream()
    assert camera.frame(1000, bench.size).block_id > 5, "frames went on being taken"


def test_a_host_that_does_not_read_gets_an_overrun_and_then_a_gap(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(idle_speed=4.0)
    camera = bench.camera()
    bench.board.ask("LIVE", 1, 500, 8000)
    bench.wires.clock.sleep_s(1.2)
    bench.board.ask("STOP")
    bench.wires.clock.sleep_s(0.1)  # what is being exposed finds no room either
    frames = []
    while True:
        try:
            frames.append(camera.frame(100, bench.size))
        except usb.core.USBTimeoutError:
            break
    whole = [f for f in frames if f.status == 0]
    lost = [f for f in frames if f.status == 0xA101]
    assert [f.block_id for f in whole] == list(range(len(whole))), "what is in the memory is not overwritten"
    assert len(whole) == 32
    assert [f.block_id for f in lost] == [len(whole)]
    assert (lost[0].payload, lost[0].valid) == (b"", 0)
    bench.board.ask("LIVE", 1, 500, 8000)
    assert camera.frame(500, bench.size).block_id > len(whole) + 20, "block ids count exposures"


def test_a_timeout_half_way_gives_what_there_is(bench: Bench) -> None:
    """The host reads one transfer over the end of the block: the trailer's short packet ends it."""
    camera = bench.camera()
    bench.board.ask("LIVE", 6, 500, 8000)
    camera.device.read(0x83, 52, 1000)
    bench.board.ask("STOP")
    buffer = array.array("B", bytes(bench.size // PACKET * PACKET))
    assert camera.device.read(0x83, buffer, 200) == len(buffer)
    rest = camera.device.read(0x83, PACKET, 200)
    assert len(rest) == bench.size % PACKET


def test_the_link_at_480_mbit_takes_its_time(make_bench: Callable[..., Bench]) -> None:
    latency_ms = []
    for options in ({}, {"faults": ("camera.left slow",)}):
        # Slowed down, so that the host's own latency hardly counts.
        bench = make_bench(width_px=800, height_px=600, idle_speed=0.2, **options)
        camera = bench.camera()
        bench.board.ask("LIVE", 60, 500, 8000)
        leader = camera.device.read(0x83, 52, 5000).tobytes()
        camera.put(0x1F8, 1)
        latency_ms.append((camera.u64(0x1F0) - struct.unpack_from("<Q", leader, 20)[0]) / 1e6)
    fast, slow = latency_ms
    assert slow - fast == pytest.approx(480_000 / 38e6 * 1e3 - 480_000 / 380e6 * 1e3, abs=6.0)


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
    for _ in range(3):
        last = camera.frame(1000, bench.size)
    gap_ms = (last.time_ns - first.time_ns) / 1e6
    pulses_ms = 100.0 * round(gap_ms / 100.0)
    assert gap_ms - pulses_ms == pytest.approx(later_ms, abs=0.02)


def test_exposures_that_jitter_begin_after_their_pulse(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(outside={"clocks": {"camera_jitter_us": 200.0}})
    camera = bench.camera()
    bench.board.ask("LIVE", 2, 500, 8000)
    frames = [camera.frame(1000, bench.size) for _ in range(30)]
    gaps_us = np.diff([f.time_ns for f in frames]) / 1000 - 33_333.3
    assert 150.0 < gaps_us.std() < 450.0, "√2 times 200 µs"
    assert abs(gaps_us.mean()) < 100.0
