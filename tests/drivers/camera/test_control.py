"""The control channel against a scripted device: every answer below is spelled out in bytes."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import DeviceError, DeviceGone, DeviceRefused
from drivers.camera.control import ATTEMPTS, ControlChannel, ControlCounters, ControlRefused
from drivers.camera.usb import TransferError, TransferOverflow, TransferStalled, TransferTimeout, Unplugged
from tests.drivers.clock import SteppedClock
from tests.support.damage import damaged

SILENCE = TransferTimeout("nothing")
Respond = Callable[[bytes], Sequence[bytes | Exception | float]]


def answer(request: bytes, payload: bytes, *, status: int = 0, command: int | None = None, id_offset: int = 0) -> bytes:
    _, _, code, _, number = struct.unpack_from("<IHHHH", request)
    code = code + 1 if command is None else command
    return struct.pack("<4sHHHH", b"U3VC", status, code, len(payload), number + id_offset) + payload


class Memory:
    """A device that answers each command by a function, a number in it being a wait in seconds; it keeps what it was asked."""

    def __init__(self, clock: SteppedClock, respond: Respond) -> None:
        self.clock = clock
        self._respond = respond
        self._pending: list[bytes | Exception | float] = []
        self.commands: list[bytes] = []
        self.sizes: list[int] = []
        self.halts_cleared = 0

    @property
    def passed_s(self) -> float:
        return (self.clock.now_ns() - SteppedClock().now_ns()) * 1e-9

    def write(self, data: bytes, timeout_s: float) -> None:
        self.commands.append(data)
        self._pending += self._respond(data)

    def read(self, size: int, timeout_s: float) -> bytes:
        self.sizes.append(size)
        waited_s = 0.0
        while self._pending:
            first = self._pending.pop(0)
            if isinstance(first, bytes):
                number = self.commands[-1][10:12] if first[10:12] == b"\0\0" else first[10:12]
                first = first[:10] + number + first[12:]  # 0 is no number: that of the command
                assert len(first) <= size, "the buffer is smaller than what the device may send"
                self.clock.advance_s(waited_s)
                return first
            if isinstance(first, TransferTimeout):
                break
            if isinstance(first, Exception):
                raise first
            if waited_s + first > timeout_s:
                self._pending.insert(0, waited_s + first - timeout_s)
                break
            waited_s += first
        self.clock.advance_s(timeout_s)
        raise SILENCE

    def clear_halt(self) -> None:
        self.halts_cleared += 1


def channel(respond: Respond) -> tuple[ControlChannel, Memory]:
    memory = Memory(SteppedClock(), respond)
    return ControlChannel("camera.left", memory, memory.clock), memory


def reading(command: bytes) -> tuple[int, int]:
    address, _, count = struct.unpack_from("<QHH", command, 12)
    return address, count


def pending(wait_ms: int) -> bytes:
    return struct.pack("<4sHHHHHH", b"U3VC", 0, 0x0805, 4, 0, 0, wait_ms)


def image(address: int, count: int) -> bytes:
    return bytes((address + i) % 251 for i in range(count))


def good(command: bytes) -> list[bytes]:
    if command[6:8] == b"\x02\x08":
        return [answer(command, struct.pack("<HH", 0, len(command) - 20))]
    return [answer(command, image(*reading(command)))]


def test_long_reads_and_writes_are_cut_to_what_the_device_can_send_and_take() -> None:
    control, memory = channel(good)
    assert control.read(0x100, 200) == image(0x100, 200)
    control.write(0x2000, bytes(range(100)))
    assert [reading(c) for c in memory.commands[:4]] == [(0x100, 64), (0x140, 64), (0x180, 64), (0x1C0, 8)]
    assert [len(c) - 20 for c in memory.commands[4:]] == [64, 36], "before its limits are known: a string register"
    memory.commands.clear()
    control.set_limits(60, 100, 0.2)
    assert control.read(0x1000, 300) == image(0x1000, 300)
    control.write(0x2000, bytes(range(100)))
    assert [reading(c) for c in memory.commands[:4]] == [(0x1000, 88), (0x1058, 88), (0x10B0, 88), (0x1108, 36)]
    written = [(*struct.unpack_from("<Q", c, 12), c[20:]) for c in memory.commands[4:]]
    assert [(address, len(data)) for address, data in written] == [(0x2000, 40), (0x2028, 40), (0x2050, 20)]
    assert b"".join(data for _, data in written) == bytes(range(100))
    memory.commands.clear()
    control.set_limits(1 << 20, 1 << 20, 0.2)
    assert len(control.read(0, 70_000)) == 70_000
    assert reading(memory.commands[0]) == (0, 0xFFFF - 12), "a count has 16 bits, whatever the camera claims"
    control.write(0, bytes(70_000))
    assert max(len(c) for c in memory.commands) == 0xFFFF


@pytest.mark.parametrize(
    ("first", "commands", "counters"),
    [
        (lambda c: [answer(c, b"old!", id_offset=7), *good(c)], 1, ControlCounters(stale_answers=1)),
        (lambda c: [b"\xff" * 40, *good(c)], 1, ControlCounters(malformed_answers=1)),
        (lambda c: [answer(c, b"xy")], 2, ControlCounters(retries=1, malformed_answers=1)),
        (lambda c: [answer(c, b"four", command=0x0803)], 2, ControlCounters(retries=1, malformed_answers=1)),
        (lambda c: [answer(c, b"", status=0x8007)], 2, ControlCounters(retries=1)),
        (lambda c: [TransferStalled("halt")], 2, ControlCounters(retries=1)),
        (lambda c: [pending(0)[:12] + b"\0\0", 0.4, *good(c)], 1, ControlCounters(malformed_answers=1)),
    ],
    ids=["stale", "garbage", "wrong length", "other command", "busy", "stall", "more time without how much"],
)
def test_what_goes_wrong_once_is_repaired_and_counted(first: Respond, commands: int, counters: ControlCounters) -> None:
    control, memory = channel(lambda c: first(c) if len(memory.commands) == 1 else good(c))
    assert control.read(0x10, 4) == image(0x10, 4)
    assert (len(memory.commands), control.counters) == (commands, counters)


@pytest.mark.parametrize(
    ("respond", "failure"),
    [
        (lambda c: [], "no answer"),
        (lambda c: [TransferOverflow("babble")], "the answer was longer than allowed"),
        (lambda c: [TransferStalled("halt")], "the endpoint stalled"),
        (lambda c: [TransferError("odd")], "odd"),
        (lambda c: [answer(c, b"four")], "a wrong answer (0x0803, 4 bytes)"),
    ],
)
def test_what_fails_at_every_attempt_is_told_each_attempt_with_its_own_id(respond: Respond, failure: str) -> None:
    control, memory = channel(respond)
    with pytest.raises(DeviceGone) as caught:
        control.write_u32(0x20, 7)
    assert caught.value.device == "camera.left"
    assert caught.value.message == f"{failure} at 3 attempts of a write of 4 bytes at 0x20"
    assert [struct.unpack_from("<H", c, 10)[0] for c in memory.commands] == [1, 2, 3]
    assert control.counters.retries == 2
    assert memory.halts_cleared == (3 if "stalled" in failure else 0)


@pytest.mark.parametrize(
    ("status", "name", "remedy"),
    [
        (0x8001, "NOT_IMPLEMENTED", "camera settings"),
        (0x8003, "INVALID_ADDRESS", "Check the firmware"),
        (0x8006, "ACCESS_DENIED", "Stop the acquisition"),
        (0x8007, "busy at 3 attempts", "Try again later"),
        (0xA003, "PAYLOAD_SIZE_NOT_ALIGNED", "payload sizes"),
        (0x8ABC, "0x8abc", "camera settings"),
    ],
)
def test_a_refusal_is_named_comes_with_what_to_do_and_is_retried_only_while_the_device_is_busy(
    status: int, name: str, remedy: str
) -> None:
    control, memory = channel(lambda c: [answer(c, b"", status=status)])
    with pytest.raises(ControlRefused, match=f"camera.left: .*{name}") as caught:
        control.read(0x10, 4)
    assert remedy in caught.value.remedy
    assert caught.value.status == status
    attempts, paused_s = (ATTEMPTS, ATTEMPTS * 0.01) if status == 0x8007 else (1, 0.0)
    assert len(memory.commands) == attempts
    assert memory.passed_s == pytest.approx(paused_s)


@pytest.mark.parametrize("while_clearing", [False, True])
def test_unplugging_is_told_at_once_also_while_a_halt_is_cleared(while_clearing: bool) -> None:
    def leave() -> None:
        raise Unplugged("gone")

    control, memory = channel(lambda c: [TransferStalled("halt") if while_clearing else Unplugged("no such device")])
    memory.clear_halt = leave  # type: ignore[method-assign]
    with pytest.raises(DeviceGone, match="unplugged"):
        control.read(0, 4)
    assert len(memory.commands) == 1


def test_old_answers_are_passed_over_and_one_that_babbles_them_without_end_is_given_up() -> None:
    """An answer that comes after the retry does not shift all later ones."""
    control, memory = channel(lambda c: [] if len(memory.commands) == 1 else [*good(memory.commands[-2]), *good(c)])
    for address in (0x20, 0x40, 0x60):
        assert control.read(address, 8) == image(address, 8)
    assert control.counters == ControlCounters(retries=1, stale_answers=3)
    control, memory = channel(lambda c: [answer(c, b"old!", id_offset=7)] * 1000)
    with pytest.raises(DeviceGone, match="no answer at 3 attempts"):
        control.read_u32(0)
    assert control.counters.stale_answers == len(memory.sizes) <= 100


ANSWER = struct.pack("<4sHHHH", b"U3VC", 0, 0x0801, 4, 0) + b"data"


@pytest.mark.parametrize(
    ("said", "attempts"),
    [
        ([0.49, ANSWER], 1),
        ([0.4, pending(1000), 0.99, ANSWER], 1),
        ([0.4, pending(1000), 1.01, ANSWER], 2),
        ([pending(8000), 7.9, ANSWER], 1),
        ([pending(6000), 5.9, pending(6000), 3.9, ANSWER], 1),
        ([pending(6000), 5.9, pending(6000), 4.2, ANSWER], 2),  # ten seconds are the most for one command
    ],
)
def test_a_device_gets_the_time_it_asks_for_up_to_ten_seconds(said: list[bytes | float], attempts: int) -> None:
    control, memory = channel(lambda c: said if len(memory.commands) == 1 else [])
    assert control.read(0, 4) == b"data"
    assert len(memory.commands) == attempts
    asked_for_time = sum(isinstance(one, bytes) and one is not ANSWER for one in said)
    assert control.counters == ControlCounters(retries=attempts - 1, pending_acknowledges=asked_for_time)


@pytest.mark.parametrize(("most", "size"), [(1024, 1024), (1025, 2048), (2048, 2048), (100, 1024)])
def test_a_read_has_room_for_whole_packets(most: int, size: int) -> None:
    control, memory = channel(good)
    control.set_limits(512, most, 0.2)
    control.read(0, 4)
    assert memory.sizes == [size]


@pytest.mark.parametrize(("stated_s", "waited_s"), [(0.3, 0.3), (0.05, 0.05), (0.0, 0.05), (2.0, 2.0)])
def test_a_silent_device_is_waited_for_as_long_as_it_stated_and_at_least_50_ms(
    stated_s: float, waited_s: float
) -> None:
    control, memory = channel(lambda c: [])
    control.set_limits(512, 512, stated_s)
    with pytest.raises(DeviceGone):
        control.read(0, 4)
    assert memory.passed_s == pytest.approx(ATTEMPTS * waited_s)


@pytest.mark.parametrize(("command", "answer_size"), [(27, 20), (28, 19), (0, 4096)])
def test_a_packet_has_room_for_one_register_of_64_bits(command: int, answer_size: int) -> None:
    control, memory = channel(good)
    with pytest.raises(DeviceRefused, match=rf"{command} / {answer_size} bytes, too small for one register"):
        control.set_limits(command, answer_size, 0.2)
    control.set_limits(28, 20, 0.2)
    assert control.read(0x100, 16) == image(0x100, 16)
    control.write(0x100, bytes(16))
    assert [len(c) for c in memory.commands] == [24, 24, 28, 28]


def test_addresses_have_64_bits() -> None:
    control, memory = channel(good)
    last = (1 << 64) - 4
    assert control.read(last, 4) == image(last, 4)
    control.write(last, b"last")
    for address, count in ((-1, 4), (-4, 4), (last, 5), (1 << 64, 1)):
        for refused in (control.read, lambda at, many: control.write(at, bytes(many))):
            with pytest.raises(DeviceRefused, match=f"{count} bytes at {address:#x}, outside 64 bits"):
                refused(address, count)
    with pytest.raises(DeviceRefused, match="outside 64 bits"):
        control.read(0, -1)
    assert len(memory.commands) == 2, "nothing was asked"


@pytest.mark.parametrize(
    ("payload", "command", "attempts"),
    [
        (struct.pack("<HH", 0, 4), 0x0803, 1),
        (struct.pack("<HH", 0, 0), 0x0803, 1),
        (b"", 0x0803, 1),
        (struct.pack("<HH", 0, 3), 0x0803, 2),
        (struct.pack("<HH", 0, 4), 0x0801, 2),
    ],
)
def test_a_write_counts_when_the_device_says_all_of_it_or_nothing_about_it(
    payload: bytes, command: int, attempts: int
) -> None:
    control, memory = channel(lambda c: [answer(c, payload, command=command)] if len(memory.commands) == 1 else good(c))
    control.write_u32(0x20, 7)
    assert len(memory.commands) == attempts
    assert control.counters.malformed_answers == attempts - 1


babble = st.one_of(
    st.binary(max_size=40),
    damaged([ANSWER, pending(300)]).map(lambda data: data[:1024]),  # a transfer ends with its buffer
    st.tuples(
        st.sampled_from([0, 0x8007, 0x8ABC]),
        st.sampled_from([0x0801, 0x0803, 0x0805, 0x1234]),
        st.integers(0, 4),
        st.binary(max_size=8),
    ).map(lambda drawn: struct.pack("<4sHHHH", b"U3VC", *drawn[:2], len(drawn[3]), drawn[2]) + drawn[3]),
    st.sampled_from([SILENCE, TransferStalled("halt"), TransferOverflow("babble"), Unplugged("gone")]),
)


@given(st.lists(babble, max_size=60))
def test_whatever_a_mad_device_says_ends_in_bounded_time_as_data_or_a_named_error(
    said: list[bytes | Exception],
) -> None:
    script = iter([said[i : i + 7] for i in range(0, len(said), 7)])
    control, memory = channel(lambda command: next(script, []))
    with contextlib.suppress(DeviceError):
        assert len(control.read(0x100, 4)) == 4
    assert len(memory.commands) <= ATTEMPTS
    assert memory.passed_s < 10.6 * ATTEMPTS
