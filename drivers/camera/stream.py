"""The image stream: from transfers to frames, and resynchronisation after damage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.api import Clock, DeviceGone, Frame, FrameStatus
from drivers.camera import gencp, u3v
from drivers.camera.packets import (
    Leader,
    MalformedStreamPacket,
    Trailer,
    is_leader,
    is_trailer,
    parse_leader,
    parse_trailer,
)
from drivers.camera.pixels import PixelFormat
from drivers.camera.usb import (
    StreamPipe,
    TransferBuffer,
    TransferError,
    TransferOverflow,
    TransferStalled,
    TransferTimeout,
    Unplugged,
    transfer_buffer,
)

PAYLOAD_TIMEOUT_S = 0.25
"""Timeout from the leader to the end of the payload: 1.92 MB take 5 ms at SuperSpeed and 50 ms at 480 Mbit/s."""
TRAILER_TIMEOUT_S = 0.1
FLUSH_TIMEOUT_S = 0.02
FLUSH_LIMIT = 256
"""Largest number of transfers that one flush drops."""
STALE_LIMIT = 32
"""Largest number of frames of an earlier acquisition that are dropped in one call."""
_RESYNC_LIMIT = 4096
"""Largest number of transfers skipped in one search for a leader."""


@dataclass(frozen=True, slots=True)
class StreamGeometry:
    """Geometry that every frame of a running stream must have."""

    width_px: int
    height_px: int
    format: PixelFormat
    payload_size: int
    transfers: tuple[int, ...]
    """Sizes of the payload's transfers, multiples of the camera's alignment; usually one."""
    packet_buffer_size: int
    """Memory for a leader or trailer: the camera's largest, in whole packets."""

    @property
    def transfer_size(self) -> int:
        """Bytes of all transfers of an image, padding included."""
        return sum(self.transfers)


@dataclass(slots=True)
class StreamCounters:
    """Events of the reader since the stream was started."""

    frames: int = 0
    damaged_frames: int = 0
    timeouts: int = 0
    stale_frames: int = 0
    """Frames from before the acquisition, which arrived late."""
    skipped_transfers: int = 0
    """Transfers dropped on the way to the next leader."""


class StreamReader:
    """Reads frames of one running stream, for one thread.

    A leader is only accepted at the start of a transfer. After any damage the reader drops transfers until the next one
    that is a leader, so one bad frame costs one frame. A leader that arrives where a trailer or payload was due is kept
    for the next call.
    """

    def __init__(self, name: str, pipe: StreamPipe, geometry: StreamGeometry, clock: Clock) -> None:
        self._name = name
        self._pipe = pipe
        self._geometry = geometry
        self._clock = clock
        self._scratch = transfer_buffer(np.zeros(geometry.packet_buffer_size, np.uint8))
        padded = geometry.transfer_size != geometry.width_px * geometry.height_px or geometry.format.reduce is not None
        # Only for image sizes that are no multiple of the camera's alignment, and for more than 8 bits.
        self._bounce = transfer_buffer(np.zeros(geometry.transfer_size, np.uint8)) if padded else None
        # One maximal packet more than a payload: the remainder of any frame ends in it with a short packet.
        self._waste: TransferBuffer | None = None
        self._pending: bytes | None = None
        self._since_ns: int | None = None
        self._payloads_failed = 0
        self.counters = StreamCounters()

    @property
    def whole_transfers_fail(self) -> bool:
        """True if images in one large transfer failed and none was complete, so that pieces may help."""
        is_one_transfer = len(self._geometry.transfers) == 1
        complete = self.counters.frames - self.counters.damaged_frames - self.counters.timeouts
        return is_one_transfer and self._payloads_failed > 0 and complete == 0

    def flush(self) -> None:
        """Drop the queued transfers of the pipe. Raises DeviceGone."""
        self._pending = None
        for _ in range(FLUSH_LIMIT):
            try:
                self._read(self._waste_buffer(), FLUSH_TIMEOUT_S)
            except (TransferTimeout, TransferStalled):
                return  # a halted endpoint has no queued transfers
            except TransferError:
                continue  # after an overflow there may be more

    def expect_since(self, camera_ns: int | None) -> None:
        """Drop frames that are older than this time of the camera's clock, up to the first that is not.

        ``None``: take every frame.
        """
        self._since_ns = camera_ns

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> Frame:
        """Return the next frame, with its image in ``slot``; see ``drivers.api.Camera``.

        Raises ValueError for a slot of another shape or kind, DeviceGone when the camera is lost.
        """
        geometry = self._geometry
        if slot.shape != (geometry.height_px, geometry.width_px):
            raise ValueError(
                f"slot of shape {slot.shape}, but the frames of {self._name} are {geometry.height_px} x "
                f"{geometry.width_px}"
            )
        target = transfer_buffer(slot)
        deadline_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        frame = self._next_frame(target, deadline_ns)
        # Frames that were exposed or read out when the earlier acquisition was stopped may arrive once the stream is
        # open again. A camera has room for few of them.
        for _ in range(STALE_LIMIT):
            if not self._stale(frame):
                break
            self.counters.stale_frames += 1
            frame = self._next_frame(target, deadline_ns)
        if frame.camera_time_ns is not None:
            self._since_ns = None
        self.counters.frames += 1
        if frame.status is FrameStatus.TIMEOUT:
            self.counters.timeouts += 1
        elif frame.status is not FrameStatus.COMPLETE:
            self.counters.damaged_frames += 1
        return frame

    def _stale(self, frame: Frame) -> bool:
        stamp_ns, since_ns = frame.camera_time_ns, self._since_ns
        return stamp_ns is not None and since_ns is not None and stamp_ns < since_ns

    def _next_frame(self, target: TransferBuffer, deadline_ns: int) -> Frame:
        try:
            packet = self._find_leader(deadline_ns)
        except TransferTimeout:
            return self._frame(FrameStatus.TIMEOUT, None, "no leader")
        except TransferError as error:
            return self._frame(FrameStatus.CORRUPT, None, f"no leader ({error})")
        try:
            leader = parse_leader(packet)
        except MalformedStreamPacket as error:
            return self._frame(FrameStatus.CORRUPT, None, str(error))
        # The geometry was fixed when the stream began; a leader with another one is damaged, or another program
        # configured the camera.
        problem = self._unexpected(leader)
        if problem:
            # Its payload has another size than the slot: left for the search of the next leader.
            return self._frame(FrameStatus.CORRUPT, leader, problem)
        count, problem = self._read_payload(target)
        # The next frame has begun: this one ends here, and its successor must not be lost with it.
        if self._pending is not None:
            return self._frame(FrameStatus.TRUNCATED, leader, problem)
        trailer, trailer_problem = self._read_trailer()
        return self._judge(leader, count, problem, trailer, trailer_problem)

    def _judge(self, leader: Leader, count: int, problem: str, trailer: Trailer | None, trailer_problem: str) -> Frame:
        """Return the frame with its status, by the most specific fault."""
        expected = self._geometry.payload_size
        # The camera reports dropped data: more specific than a missing length.
        if trailer is not None and trailer.status in (u3v.Status.DATA_DISCARDED, u3v.Status.DATA_OVERRUN):
            return self._frame(FrameStatus.DISCARDED, leader, gencp.status_name(trailer.status))
        if count != expected:
            return self._frame(FrameStatus.TRUNCATED, leader, problem or f"payload of {count} of {expected} bytes")
        if trailer is None:
            status = FrameStatus.TRUNCATED if trailer_problem.startswith("no trailer") else FrameStatus.CORRUPT
            return self._frame(status, leader, trailer_problem)
        # Leader and trailer of two frames around one payload: packets in between were lost.
        if trailer.block_id != leader.block_id:
            return self._frame(FrameStatus.WRONG_ID, leader, f"leader {leader.block_id}, trailer {trailer.block_id}")
        if trailer.status != u3v.Status.SUCCESS:
            return self._frame(FrameStatus.CORRUPT, leader, gencp.status_name(trailer.status))
        if trailer.valid_payload_size != expected or trailer.height_px != self._geometry.height_px:
            return self._frame(
                FrameStatus.TRUNCATED,
                leader,
                f"trailer reports {trailer.valid_payload_size} of {expected} bytes, "
                f"{trailer.height_px} of {self._geometry.height_px} lines",
            )
        return self._frame(FrameStatus.COMPLETE, leader, "")

    def _unexpected(self, leader: Leader) -> str:
        geometry = self._geometry
        if leader.pixel_format != geometry.format.code:
            return f"pixel format {leader.pixel_format:#010x}, expected {geometry.format.name}"
        if (leader.width_px, leader.height_px) != (geometry.width_px, geometry.height_px) or leader.x_padding:
            return (
                f"image of {leader.width_px} x {leader.height_px} with padding {leader.x_padding}, "
                f"expected {geometry.width_px} x {geometry.height_px}"
            )
        return ""

    def _find_leader(self, deadline_ns: int) -> bytes:
        """Return the transfer that begins the next frame. Raises TransferError.

        A short transfer of the size of a leader without its magic is a damaged leader when the stream was in step, and
        is returned as it is; all other transfers before a leader are skipped.
        """
        if self._pending is not None:
            packet, self._pending = self._pending, None
            return packet
        in_step = True
        for _ in range(_RESYNC_LIMIT):
            remaining_s = (deadline_ns - self._clock.now_ns()) * 1e-9
            if remaining_s <= 0:
                break
            packet = self._read_packet(remaining_s)
            if is_leader(packet):
                return packet
            self.counters.skipped_transfers += 1
            # In step a leader is due: one without its magic is a frame, damaged. Out of step it may be a piece of
            # image.
            if in_step and len(packet) == u3v.LEADER_SIZE:
                return packet
            in_step = False
            if len(packet) == self._scratch.size:
                # In the middle of a payload: skip the remainder at once, it ends with the trailer's short packet.
                self._skip_rest(deadline_ns)
        raise TransferTimeout("no leader")

    def _skip_rest(self, deadline_ns: int) -> None:
        remaining_s = max(0.0, (deadline_ns - self._clock.now_ns()) * 1e-9)
        try:
            self._read(self._waste_buffer(), min(PAYLOAD_TIMEOUT_S, remaining_s))
        except TransferError:
            return  # no more data: the next transfer is examined by itself

    def _read_payload(self, target: TransferBuffer) -> tuple[int, str]:
        """Return the number of image bytes that came, and the fault if some are missing."""
        buffer = target if self._bounce is None else self._bounce
        count, problem = 0, ""
        for size in self._geometry.transfers:
            try:
                got = self._read(buffer[count : count + size].view(TransferBuffer), PAYLOAD_TIMEOUT_S)
            except TransferTimeout:
                problem = "no payload"
            except TransferOverflow:
                problem = "payload longer than the image"
            except TransferError as error:
                problem = f"payload failed ({error})"
            if problem:
                self._payloads_failed += 1
                return 0, problem
            count += got
            if got < size:
                break  # a short packet ends an incomplete image
        head = buffer[: u3v.LEADER_SIZE].tobytes() if count == u3v.LEADER_SIZE else b""
        if is_leader(head):
            self._pending = head
            return 0, "the next leader came instead of the payload"
        # Padding up to the camera's transfer size is no part of the image.
        count = min(count, self._geometry.payload_size)
        if count < self._geometry.payload_size:
            self._payloads_failed += 1
        reduce = self._geometry.format.reduce
        if self._bounce is not None and reduce is None:
            target[:count] = self._bounce[:count]
        elif self._bounce is not None and reduce is not None and count == self._geometry.payload_size:
            reduce(self._bounce[:count], target)
        return count, ""

    def _read_trailer(self) -> tuple[Trailer | None, str]:
        try:
            packet = self._read_packet(TRAILER_TIMEOUT_S)
        except TransferTimeout:
            return None, "no trailer"
        except TransferError as error:
            return None, f"no trailer ({error})"
        if is_leader(packet):
            self._pending = packet
            return None, "no trailer: the next leader came instead"
        try:
            return parse_trailer(packet), ""
        except MalformedStreamPacket as error:
            if is_trailer(packet):
                return None, str(error)
            return None, f"not a trailer ({error})"

    def _read_packet(self, timeout_s: float) -> bytes:
        count = self._read(self._scratch, timeout_s)
        return self._scratch[:count].tobytes()

    def _read(self, buffer: TransferBuffer, timeout_s: float) -> int:
        """Return the length of one transfer; a halt is cleared before it is reported.

        Raises TransferError, DeviceGone.
        """
        try:
            return self._pipe.read_into(buffer, timeout_s)
        except TransferStalled:
            self.clear_halt()
            raise
        except Unplugged as error:
            raise self._gone() from error

    def reset_endpoint(self) -> None:
        """Halt the stream endpoint and clear it. Raises DeviceGone.

        A device may ignore a clear alone after an earlier program left the endpoint halted.
        """
        try:
            self._pipe.set_halt()
        except Unplugged as error:
            raise self._gone() from error
        self.clear_halt()

    def clear_halt(self) -> None:
        """Make the stream endpoint usable again. Raises DeviceGone."""
        try:
            self._pipe.clear_halt()
        except Unplugged as error:
            raise self._gone() from error

    def _gone(self) -> DeviceGone:
        return DeviceGone(self._name, "unplugged while streaming", "Check the connector; it is opened again by itself")

    def _waste_buffer(self) -> TransferBuffer:
        if self._waste is None:
            # A multiple of the packet size: a bulk read of any other length ends in an overflow when the device sends a
            # whole packet more.
            packets = -(-self._geometry.transfer_size // u3v.SUPERSPEED_PACKET) + 1
            size = packets * u3v.SUPERSPEED_PACKET + self._geometry.packet_buffer_size
            self._waste = transfer_buffer(np.zeros(size, np.uint8))
        return self._waste

    def _frame(self, status: FrameStatus, leader: Leader | None, detail: str) -> Frame:
        return Frame(
            status=status,
            block_id=None if leader is None else leader.block_id,
            camera_time_ns=None if leader is None else leader.timestamp_ns,
            received_ns=self._clock.now_ns(),
            detail=detail,
        )
