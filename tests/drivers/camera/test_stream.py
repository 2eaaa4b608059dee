"""The stream reader against a pipe of packets: what the diver's ledger must learn about every damaged frame."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.api import DeviceGone, Frame, FrameStatus
from drivers.camera.pixels import FORMATS
from drivers.camera.stream import StreamCounters, StreamGeometry, StreamReader
from drivers.camera.usb import (
    TransferBuffer,
    TransferError,
    TransferOverflow,
    TransferStalled,
    TransferTimeout,
    Unplugged,
    transfer_buffer,
)
from tests.drivers.clock import SteppedClock
from tests.support.damage import damaged

WIDTH, HEIGHT = 64, 48  # 3 packets of 1024: the payload ends without a short packet, as 1600 x 1200 does
PIXELS = WIDTH * HEIGHT
PACKET = 1024
MONO8 = FORMATS["Mono8"]


class Pipe:
    """A bulk IN pipe: packets of at most 1024 bytes; a transfer ends when full or with a short packet."""

    def __init__(self, clock: SteppedClock) -> None:
        self._clock = clock
        self._packets: list[bytes | Exception] = []
        self.halts_cleared = 0

    def send(self, *messages: bytes | Exception) -> None:
        for message in messages:
            if isinstance(message, Exception):
                self._packets.append(message)
            else:
                self._packets += [message[i : i + PACKET] for i in range(0, len(message), PACKET)]

    def read_into(self, buffer: TransferBuffer, timeout_s: float) -> int:
        done = 0
        while done < buffer.size:
            if not self._packets:
                self._clock.advance_s(timeout_s)
                if done:
                    return done
                raise TransferTimeout("nothing")
            packet = self._packets.pop(0)
            if isinstance(packet, Exception):
                raise packet
            if len(packet) > buffer.size - done:
                raise TransferOverflow("babble")
            buffer[done : done + len(packet)] = np.frombuffer(packet, np.uint8)
            done += len(packet)
            if len(packet) < PACKET:
                break
        return done

    def set_halt(self) -> None:
        """A device that takes no request to halt."""

    def clear_halt(self) -> None:
        self.halts_cleared += 1


def leader(block: int, *, width: int = WIDTH, height: int = HEIGHT, pixel_format: int = 0x01080001) -> bytes:
    return struct.pack(
        "<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, block, 0, 1, 1000 + block, pixel_format, width, height, 0, 0, 0, 0
    )


def trailer(block: int, *, status: int = 0, valid: int = PIXELS, height: int = HEIGHT) -> bytes:
    return struct.pack("<4sHHQHHQI", b"U3VT", 0, 32, block, status, 0, valid, height)


def image(block: int) -> NDArray[np.uint8]:
    return ((np.arange(PIXELS) * 7 + block) % 256).astype(np.uint8).reshape(HEIGHT, WIDTH)


def frame(block: int) -> tuple[bytes, bytes, bytes]:
    return leader(block), image(block).tobytes(), trailer(block)


class Bench:
    def __init__(self, transfer_size: int = PIXELS) -> None:
        self.clock = SteppedClock()
        self.pipe = Pipe(self.clock)
        geometry = StreamGeometry(WIDTH, HEIGHT, MONO8, PIXELS, (transfer_size,), PACKET)
        self.reader = StreamReader("camera.left", self.pipe, geometry, self.clock)
        self.slot = np.zeros((HEIGHT, WIDTH), np.uint8)

    def next(self, timeout_s: float = 0.5) -> Frame:
        return self.reader.next_frame(self.slot, timeout_s)

    def expect_whole(self, block: int) -> None:
        got = self.next()
        assert (got.status, got.block_id) == (FrameStatus.COMPLETE, block), got
        np.testing.assert_array_equal(self.slot, image(block))


def test_a_frame_lands_in_the_callers_memory_with_id_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    seen: list[tuple[int, int]] = []
    read = bench.pipe.read_into

    def noted(buffer: TransferBuffer, timeout_s: float) -> int:
        seen.append(buffer.buffer_info())
        return read(buffer, timeout_s)

    monkeypatch.setattr(bench.pipe, "read_into", noted)
    bench.pipe.send(*frame(9))
    bench.clock.advance_s(3.0)
    assert bench.next() == Frame(FrameStatus.COMPLETE, 9, 1009, bench.clock.now_ns(), "")
    np.testing.assert_array_equal(bench.slot, image(9))
    assert (bench.slot.ctypes.data, PIXELS) in seen, "straight from the wire"
    bench = Bench(transfer_size=4096)
    bench.pipe.send(leader(1), image(1).tobytes() + bytes(1000), trailer(1))
    bench.expect_whole(1)  # one whose size is off the alignment, too


def test_frames_stamped_before_the_acquisition_are_dropped_whole_or_damaged_up_to_the_first_of_its_own() -> None:
    bench = Bench()
    bench.reader.expect_since(1020)
    bench.pipe.send(*frame(17), leader(18), image(18).tobytes()[:1500], trailer(18), *frame(20), *frame(19))
    bench.expect_whole(20)
    assert bench.reader.counters.stale_frames == 2
    bench.expect_whole(19)  # from here on, the order of stamps is the ledger's to judge
    assert bench.reader.counters.stale_frames == 2

    for block in range(40):
        bench.pipe.send(*frame(block))
    bench.reader.expect_since(10**6)
    assert bench.next().block_id == 32, "a stream of nothing but old frames is no endless wait"


def test_a_slot_that_cannot_be_filled_in_place_is_refused() -> None:
    for bad in (np.zeros((4, 8), np.uint8)[:, ::2], np.zeros((4, 8), np.uint16), np.frombuffer(b"1234", np.uint8)):
        with pytest.raises(ValueError, match="C-contiguous writable uint8"):
            transfer_buffer(bad)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="48 x 64"):
        Bench().reader.next_frame(np.zeros((WIDTH, HEIGHT), np.uint8), 0.1)


WHOLE = image(1).tobytes()
PADDED = leader(1)[:48] + b"\x04\0" + leader(1)[50:]
SHORT = trailer(1)[:6] + b"\x1f\0" + trailer(1)[8:]
NOISE = bytes(range(100, 152))
CUT, CORRUPT, DISCARDED = FrameStatus.TRUNCATED, FrameStatus.CORRUPT, FrameStatus.DISCARDED
Sent = tuple[bytes | Exception, ...]


@pytest.mark.parametrize(
    ("sent", "status", "block", "detail"),
    [
        ((leader(1), WHOLE[:1500], trailer(1, valid=1500)), CUT, 1, "1500 of 3072"),
        ((leader(1), WHOLE[:2048], trailer(1)), CUT, 1, ""),  # swallows the trailer, not the next frame
        ((leader(1), TransferOverflow("babble"), trailer(1)), CUT, 1, "payload longer than the image"),
        ((leader(1), TransferStalled("halt"), trailer(1)), CUT, 1, "payload failed (halt)"),
        ((leader(1), trailer(1)), CUT, 1, ""),
        ((leader(1),), CUT, 1, ""),
        ((leader(1), WHOLE), CUT, 1, "no trailer"),
        ((leader(1), WHOLE, TransferStalled("halt")), CUT, 1, "no trailer (halt)"),
        ((leader(1), WHOLE, bytes(32)), CORRUPT, 1, "not a trailer ("),
        ((leader(1), WHOLE, SHORT), CORRUPT, 1, "trailer says 31 bytes, 32 arrived"),
        ((leader(1), WHOLE, trailer(2)), FrameStatus.WRONG_ID, 1, "leader 1, trailer 2"),
        ((leader(1), WHOLE, trailer(1, status=0xA100)), DISCARDED, 1, "DATA_DISCARDED (0xa100)"),
        ((leader(1), WHOLE[:1500], trailer(1, status=0xA100, valid=1500)), DISCARDED, 1, "DATA_DISCARDED (0xa100)"),
        ((leader(1), WHOLE, trailer(1, status=0xA101)), DISCARDED, 1, "0xa101"),
        ((leader(1), WHOLE, trailer(1, status=0x8FFF)), CORRUPT, 1, "0x8fff"),
        ((leader(1), WHOLE, trailer(1, valid=PIXELS - 64)), CUT, 1, ""),
        ((leader(1), WHOLE, trailer(1, height=HEIGHT - 1)), CUT, 1, ""),
        ((NOISE, WHOLE, trailer(1)), CORRUPT, None, ""),
        ((TransferStalled("halt"),), CORRUPT, None, ""),
        ((TransferError("short"),), CORRUPT, None, ""),
        ((leader(1, width=32), WHOLE, trailer(1)), CORRUPT, 1, "32 x 48"),
        ((leader(1, height=32), WHOLE, trailer(1)), CORRUPT, 1, "64 x 32 with padding 0"),
        ((PADDED, WHOLE, trailer(1)), CORRUPT, 1, "64 x 48 with padding 4"),
        ((leader(1, pixel_format=0x01100007), WHOLE, trailer(1)), CORRUPT, 1, "0x01100007"),
    ],
)
def test_a_damaged_frame_says_what_it_is_and_costs_no_other(
    sent: Sent, status: FrameStatus, block: int | None, detail: str
) -> None:
    bench = Bench()
    bench.pipe.send(*sent, *frame(2))
    got = bench.next()
    assert (got.status, got.block_id) == (status, block)
    assert detail in got.detail
    bench.expect_whole(2)
    assert bench.reader.counters.damaged_frames == 1
    assert bench.pipe.halts_cleared == sum(isinstance(one, TransferStalled) for one in sent)


@pytest.mark.parametrize("before", [(), (leader(1),), (leader(1), image(1).tobytes())])
def test_unplugging_at_any_place_of_a_frame_is_a_lost_device(before: tuple[bytes, ...]) -> None:
    bench = Bench()
    bench.pipe.send(*before, Unplugged("gone"))
    with pytest.raises(DeviceGone, match=r"camera\.left"):
        bench.next()


def test_a_reader_that_joins_in_the_middle_of_a_frame_or_of_noise_finds_the_next_and_counts_all() -> None:
    bench = Bench()
    bench.pipe.send(image(1).tobytes()[1024:], trailer(1), *frame(2))
    bench.expect_whole(2)
    assert bench.reader.counters.skipped_transfers == 1, "the rest of a frame is taken at once"
    bench = Bench()
    bench.pipe.send(*frame(1), leader(2), image(2).tobytes()[:100], trailer(2), b"stray", NOISE, *frame(3))
    statuses = [bench.next().status for _ in range(4)]
    assert statuses == [FrameStatus.COMPLETE, FrameStatus.TRUNCATED, FrameStatus.COMPLETE, FrameStatus.TIMEOUT]
    assert bench.reader.counters == StreamCounters(frames=4, damaged_frames=1, timeouts=1, skipped_transfers=2)


def test_flushing_leaves_nothing_of_the_past() -> None:
    bench = Bench()
    bench.pipe.send(leader(1), leader(2))
    assert bench.next().status is FrameStatus.TRUNCATED  # and the second leader is kept for the next frame
    bench.pipe.send(TransferOverflow("babble"), *frame(3), *frame(4))
    begin_ns = bench.clock.now_ns()
    bench.reader.flush()
    assert bench.clock.now_ns() - begin_ns == 20_000_000
    bench.pipe.send(*frame(0))
    bench.expect_whole(0)
    bench.pipe.send(TransferStalled("halt"), *frame(5))
    begin_ns = bench.clock.now_ns()
    bench.reader.flush()
    assert (bench.pipe.halts_cleared, bench.clock.now_ns()) == (1, begin_ns)


def test_a_payload_has_a_quarter_of_a_second_a_trailer_a_tenth_and_a_leader_what_is_asked() -> None:
    """1.92 MB take 50 ms on the slowest link that there is, five times as long is a frame that was lost."""
    bench = Bench()
    for sent, status, detail, waited_s in (
        ([leader(1)], FrameStatus.TRUNCATED, "no payload", 0.25 + 0.1),  # its trailer is waited for as well
        ([leader(2), image(2).tobytes()], FrameStatus.TRUNCATED, "no trailer", 0.1),
        ([], FrameStatus.TIMEOUT, "", 0.3),
    ):
        bench.pipe.send(*sent)
        begin_ns = bench.clock.now_ns()
        got = bench.next(0.3)
        assert (bench.clock.now_ns() - begin_ns) * 1e-9 == pytest.approx(waited_s, abs=0.002)
        assert got.status is status
        assert detail in got.detail


def test_a_pipe_that_never_runs_dry_keeps_neither_a_flush_nor_a_search_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, reads = Bench(), 0

    def read_noise(buffer: TransferBuffer, timeout_s: float) -> int:
        """Read what a camera sends that never stops, and takes no time for it."""
        nonlocal reads
        reads += 1
        assert reads < 20_000, "it reads for ever"
        buffer[:5] = np.frombuffer(b"noise", np.uint8)
        return 5

    monkeypatch.setattr(bench.pipe, "read_into", read_noise)
    bench.reader.flush()
    assert 100 < reads < 1000
    assert bench.next().status is FrameStatus.TIMEOUT
    assert bench.reader.counters.timeouts == 1


@given(
    st.lists(
        st.one_of(
            st.binary(min_size=1, max_size=3000),
            damaged([leader(7), trailer(7), leader(8) + bytes(16)]).filter(bool),
            st.sampled_from([leader(7), trailer(7), image(7).tobytes(), leader(7)[:51], trailer(8, status=0xA100)]),
            st.sampled_from([TransferStalled("halt"), TransferOverflow("babble"), TransferError("short")]),
        ),
        max_size=12,
    )
)
def test_after_any_damage_a_good_frame_is_found_and_nothing_false_is_called_complete(
    damage: list[bytes | Exception],
) -> None:
    bench = Bench()
    bench.pipe.send(*damage, b"\0", *frame(41), *frame(42), *frame(43))
    seen: list[int | None] = []
    for _ in range(len(damage) + 8):
        bench.slot[:] = 0
        got = bench.next(2.0)
        if got.status is FrameStatus.COMPLETE:
            assert got.block_id is not None
            if got.block_id != 7:  # a 7 may have been put together by chance from the pieces above
                np.testing.assert_array_equal(bench.slot, image(got.block_id))
            seen.append(got.block_id)
        if got.status is FrameStatus.TIMEOUT:
            break
    # The first may be swallowed by a payload that the damage announced; the later ones are safe.
    assert seen[-2:] == [42, 43]
