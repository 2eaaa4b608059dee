"""The control channel: one command at a time, with retries, in chunks of the device's packet size."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from drivers.api import Clock, DeviceGone, DeviceRefused
from drivers.camera import gencp, u3v
from drivers.camera.gencp import Answer, MalformedPacket
from drivers.camera.usb import ControlPipe, TransferError, TransferOverflow, TransferStalled, TransferTimeout, Unplugged

ATTEMPTS = 3
RESPONSE_TIME_S = 0.5
"""Response time until the device's own "maximum device response time" is known."""
PENDING_LIMIT_S = 10.0
"""Longest total wait that a device may request by PENDING_ACK for one command."""
_INITIAL_SIZE = 64
"""Packet size until the device's own limits are known; every U3V device accepts a 64-byte string register."""
_STALE_LIMIT = 16
"""Answers to earlier commands that are dropped before a command counts as failed."""


_Pack = Callable[[int], bytes]
_Usable = Callable[[Answer], bool]


class ControlRefused(DeviceRefused):
    """The camera answered with a status that is not success. ``status`` is the raw code."""

    def __init__(self, device: str, message: str, remedy: str, status: int) -> None:
        super().__init__(device, message, remedy)
        self.status = status


@dataclass(slots=True)
class ControlCounters:
    """Errors that were repaired since the channel was opened."""

    retries: int = 0
    stale_answers: int = 0
    malformed_answers: int = 0
    pending_acknowledges: int = 0


_REMEDY = {
    u3v.Status.ACCESS_DENIED: "Stop the acquisition first, or close the other program",
    u3v.Status.WRITE_PROTECT: "The register is read only in this state",
    u3v.Status.BUSY: "Try again later",
    u3v.Status.INVALID_ADDRESS: "Check the firmware: its description and its registers disagree",
    u3v.Status.STREAM_REGISTERS_INCONSISTENT: "Check the payload sizes of the stream",
    u3v.Status.PAYLOAD_SIZE_NOT_ALIGNED: "Check the payload sizes of the stream",
}


class ControlChannel:
    """Reads and writes the camera's register memory, safe to call from several threads.

    Raises ControlRefused when the camera refuses, DeviceGone when it is unplugged or silent after all attempts. A retry
    uses a new request id, so that a late answer is distinguished from the expected one.
    """

    def __init__(self, name: str, pipe: ControlPipe, clock: Clock) -> None:
        self._name = name
        self._pipe = pipe
        self._clock = clock
        self._lock = threading.Lock()
        self._request_id = 0
        self._response_time_s = RESPONSE_TIME_S
        self._max_command = _INITIAL_SIZE + u3v.CONTROL_HEADER_SIZE + u3v.WRITE_ADDRESS_SIZE
        self._max_answer = _INITIAL_SIZE + u3v.CONTROL_HEADER_SIZE
        self.counters = ControlCounters()

    def set_limits(self, max_command_size: int, max_answer_size: int, response_time_s: float) -> None:
        """Adopt the limits of the bootstrap registers.

        Raises DeviceRefused for limits too small for one register.
        """
        if max_command_size < u3v.CONTROL_HEADER_SIZE + u3v.WRITE_ADDRESS_SIZE + 8 or max_answer_size < (
            u3v.CONTROL_HEADER_SIZE + 8
        ):
            raise DeviceRefused(
                self._name,
                f"claims packets of {max_command_size} / {max_answer_size} bytes, too small for one register",
                "Update the camera's firmware",
            )
        with self._lock:
            # The count fields of both commands are 16 bits wide.
            self._max_command = min(max_command_size, 0xFFFF)
            self._max_answer = min(max_answer_size, 0xFFFF)
            self._response_time_s = max(response_time_s, 0.05)

    def read(self, address: int, count: int) -> bytes:
        """Read ``count`` bytes from ``address``, in as many commands as needed."""
        self._check_range(address, count)
        # The payload of an answer is all but its header.
        chunk = self._max_answer - u3v.CONTROL_HEADER_SIZE
        pieces: list[bytes] = []
        done = 0
        while done < count:
            size = min(chunk, count - done)
            pieces.append(self._read_once(address + done, size))
            done += size
        return b"".join(pieces)

    def write(self, address: int, data: bytes) -> None:
        """Write ``data`` at ``address``, in as many commands as needed."""
        self._check_range(address, len(data))
        chunk = self._max_command - u3v.CONTROL_HEADER_SIZE - u3v.WRITE_ADDRESS_SIZE
        for offset in range(0, len(data), chunk):
            self._write_once(address + offset, data[offset : offset + chunk])

    def read_u32(self, address: int) -> int:
        """Return one 32-bit register."""
        return int.from_bytes(self.read(address, 4), "little")

    def read_u64(self, address: int) -> int:
        """Return one 64-bit register."""
        return int.from_bytes(self.read(address, 8), "little")

    def write_u32(self, address: int, value: int) -> None:
        """Write one 32-bit register."""
        self.write(address, value.to_bytes(4, "little"))

    def _check_range(self, address: int, count: int) -> None:
        """Raise DeviceRefused for a range outside 64 bits: a description may compute any address."""
        if address < 0 or count < 0 or address + count > 1 << 64:
            raise DeviceRefused(
                self._name,
                f"its description puts {count} bytes at {address:#x}, outside 64 bits",
                "Update the camera's firmware",
            )

    def _read_once(self, address: int, count: int) -> bytes:
        what = f"read of {count} bytes at {address:#x}"

        def usable(answer: Answer) -> bool:
            return answer.command == u3v.ANSWER_READ and len(answer.payload) == count

        return self._transact(what, lambda request: gencp.pack_read(request, address, count), usable).payload

    def _write_once(self, address: int, data: bytes) -> None:
        what = f"write of {len(data)} bytes at {address:#x}"

        def usable(answer: Answer) -> bool:
            return answer.command == u3v.ANSWER_WRITE and gencp.parse_written(answer.payload) in (None, 0, len(data))

        self._transact(what, lambda request: gencp.pack_write(request, address, data), usable)

    def _transact(self, what: str, pack: _Pack, usable: _Usable) -> Answer:
        failure = "no answer"
        with self._lock:
            for attempt in range(ATTEMPTS):
                if attempt:
                    self.counters.retries += 1
                # A new id for each attempt, so that a late answer to an earlier one is recognised and dropped.
                self._request_id = gencp.next_request_id(self._request_id)
                try:
                    self._pipe.write(pack(self._request_id), self._response_time_s)
                    answer = self._await_answer(self._request_id)
                except TransferStalled:
                    failure = "the endpoint stalled"
                    self._clear_halt()
                    continue
                except TransferOverflow:
                    failure = "the answer was longer than allowed"
                    continue
                except TransferTimeout:
                    failure = "no answer"
                    continue
                except TransferError as error:
                    failure = str(error)
                    continue
                except Unplugged as error:
                    raise self._gone(f"unplugged during a {what}") from error
                # Busy is an answer: the camera lives, and the command is repeated after a pause.
                if answer.status == u3v.Status.BUSY:
                    failure = "busy"
                    self._clock.sleep_s(min(0.01, self._response_time_s))
                    continue
                if answer.status != u3v.Status.SUCCESS:
                    raise ControlRefused(
                        self._name,
                        f"refused the {what}: {gencp.status_name(answer.status)}",
                        _remedy(answer.status),
                        answer.status,
                    )
                if usable(answer):
                    return answer
                failure = f"a wrong answer ({answer.command:#06x}, {len(answer.payload)} bytes)"
                self.counters.malformed_answers += 1
        if failure == "busy":
            raise ControlRefused(
                self._name, f"busy at {ATTEMPTS} attempts of a {what}", _remedy(u3v.Status.BUSY), u3v.Status.BUSY
            )
        raise self._gone(f"{failure} at {ATTEMPTS} attempts of a {what}")

    def _await_answer(self, request_id: int) -> Answer:
        """Return the answer to ``request_id``.

        Older ones are dropped, PENDING_ACK prolongs the wait up to its limit.
        """
        now_ns = self._clock.now_ns()
        last_ns = now_ns + round(PENDING_LIMIT_S * 1e9)
        deadline_ns = now_ns + round(self._response_time_s * 1e9)
        # Rounded up to whole packets, for the same reason as in ``stream``.
        size = -(-self._max_answer // u3v.SUPERSPEED_PACKET) * u3v.SUPERSPEED_PACKET
        for _ in range(_STALE_LIMIT):
            # Counted, not only timed, so that a device that sends without end cannot keep the loop running.
            remaining_s = (deadline_ns - self._clock.now_ns()) * 1e-9
            if remaining_s <= 0:
                break
            try:
                answer = gencp.parse_answer(self._pipe.read(size, remaining_s))
            except MalformedPacket:
                self.counters.malformed_answers += 1
                continue
            if answer.request_id != request_id:
                self.counters.stale_answers += 1
            elif answer.command == u3v.ANSWER_PENDING:
                self.counters.pending_acknowledges += 1
                try:
                    wait_ms = gencp.parse_pending(answer.payload)
                except MalformedPacket:
                    self.counters.malformed_answers += 1
                    continue
                # PENDING_ACK names the time from now on, not from the command; a camera that asks for more again and
                # again ends at the limit.
                deadline_ns = min(self._clock.now_ns() + wait_ms * 1_000_000, last_ns)
            else:
                return answer
        raise TransferTimeout("no usable answer")

    def _clear_halt(self) -> None:
        try:
            self._pipe.clear_halt()
        except Unplugged as error:
            raise self._gone("unplugged") from error

    def _gone(self, message: str) -> DeviceGone:
        return DeviceGone(self._name, message, "Check the connector; the camera is opened again by itself")


def _remedy(status: int) -> str:
    try:
        return _REMEDY.get(u3v.Status(status), "Check the rig's camera settings")
    except ValueError:
        return "Check the rig's camera settings"
