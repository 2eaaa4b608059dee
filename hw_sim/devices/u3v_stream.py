"""The camera's stream: blocks as leader, payload and trailer, and their bulk pipe."""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass

from hw_sim.devices.gencp_memory import AccessError, Status

LEADER_BYTES, TRAILER_BYTES = 52, 32
ALIGNMENT_LOG2 = 3
LEADER_MAGIC, TRAILER_MAGIC = b"U3VL", b"U3VT"
IMAGE, IMAGE_WITH_CHUNKS = 0x0001, 0x4001
IMAGE_CHUNK, FRAME_CHUNK = 0x0001, 0x0002
CHUNK_TAIL = struct.Struct("<II")
"""USB3 Vision 1.0, chunk data: behind the bytes of each chunk come its number and its length."""
MONO8 = 0x01080001
OVERRUN = 0xA101


class Overflow(Exception):
    """A packet is longer than the rest of the host's buffer."""


@dataclass(frozen=True, slots=True)
class StreamRules:
    """The requirements of a camera's stream interface."""

    alignment_log2: int = ALIGNMENT_LOG2
    """Transfers are multiples of two to this power."""
    aligned_leader: bool = False
    """The sizes of leader and trailer must be such multiples, too."""
    sizes_once_enabled: bool = False
    """The required sizes of leader and trailer read 0 until the stream was enabled for the first time."""


@dataclass(frozen=True, slots=True)
class Region:
    """The part of the sensor that is read out, and its pixel format."""

    width: int
    height: int
    offset_x: int
    offset_y: int
    pixel_format: int = MONO8
    chunks: bool = False
    """A chunk with the frame's number follows the image."""

    @property
    def bits(self) -> int:
        """Bits of a pixel on the wire: the third byte of its number (PFNC 2.0)."""
        return self.pixel_format >> 16 & 0xFF

    @property
    def image_bytes(self) -> int:
        """Number of bytes of an image; the last one may be padded."""
        return -(-self.width * self.height * self.bits // 8)

    @property
    def payload_bytes(self) -> int:
        """Bytes of a payload: the image, and its chunks."""
        return self.image_bytes + (2 * CHUNK_TAIL.size + 8 if self.chunks else 0)

    @property
    def trailer_bytes(self) -> int:
        """Bytes of the trailer."""
        return TRAILER_BYTES + (4 if self.chunks else 0)

    def with_chunks(self, image: bytes, number: int) -> bytes:
        """Return a payload: the image, and a chunk with the frame's number if that is on."""
        if not self.chunks:
            return image
        tails = CHUNK_TAIL.pack(IMAGE_CHUNK, len(image)), CHUNK_TAIL.pack(FRAME_CHUNK, 8)
        return image + tails[0] + struct.pack("<Q", number) + tails[1]


@dataclass(frozen=True, slots=True)
class Block:
    """One image on its way to the host, possibly damaged."""

    block_id: int
    camera_time_ns: int
    region: Region
    payload: bytes | memoryview
    status: int = 0
    spoilt_leader: bytes | None = None
    spoilt_trailer: bytes | None = None

    def leader(self) -> bytes:
        """Return the leader: 52 bytes."""
        if self.spoilt_leader is not None:
            return self.spoilt_leader
        r = self.region
        kind = IMAGE_WITH_CHUNKS if r.chunks else IMAGE
        # USB3 Vision 1.0, image leader: magic, reserved, size, block id, reserved, payload type, timestamp; then the image's
        # shape.
        head = struct.pack("<4sHHQHHQ", LEADER_MAGIC, 0, LEADER_BYTES, self.block_id, 0, kind, self.camera_time_ns)
        return head + struct.pack("<IIIIIHH", r.pixel_format, r.width, r.height, r.offset_x, r.offset_y, 0, 0)

    def trailer(self) -> bytes:
        """Return the trailer: 32 bytes, with chunks 36; it has the number of valid payload bytes."""
        if self.spoilt_trailer is not None:
            return self.spoilt_trailer
        # USB3 Vision 1.0, image trailer: magic, reserved, size, block id, status, reserved; then valid bytes and rows.
        r = self.region
        head = struct.pack("<4sHHQHH", TRAILER_MAGIC, 0, r.trailer_bytes, self.block_id, self.status, 0)
        rows = min(len(self.payload) * 8 // (r.width * r.bits), r.height)
        # The layout of the chunks never changes while the stream runs, so its number is always the same.
        return head + struct.pack("<QI", len(self.payload), rows) + (struct.pack("<I", 1) if r.chunks else b"")


@dataclass(slots=True)
class Setup:
    """The host's values in the stream interface registers (SIRM)."""

    max_leader: int = 0
    max_trailer: int = 0
    size: int = 0
    count: int = 0
    final1: int = 0
    final2: int = 0

    def check(self, region: Region, rules: StreamRules) -> None:
        """Check that a block of that region fits into the transfers. Raises AccessError."""
        step = 1 << rules.alignment_log2
        if any(length % step for length in (self.size, self.final1, self.final2)):
            raise AccessError(Status.PAYLOAD_SIZE_NOT_ALIGNED)
        if rules.aligned_leader and (self.max_leader % step or self.max_trailer % step):
            raise AccessError(Status.REGISTERS_INCONSISTENT)
        # USB3 Vision 1.0, SIRM: equal transfers, then up to two final ones.
        room = self.size * self.count + self.final1 + self.final2
        if room < region.payload_bytes or self.max_leader < LEADER_BYTES or self.max_trailer < region.trailer_bytes:
            raise AccessError(Status.REGISTERS_INCONSISTENT)

    def transfers(self) -> list[int]:
        """Return the lengths of the transfers of a payload."""
        return [n for n in [self.size] * self.count + [self.final1, self.final2] if n]


@dataclass(slots=True)
class _Transfer:
    """One transfer of a block, partly sent."""

    data: memoryview
    terminated: bool
    """An empty packet follows when the last one is full, since the host expects more."""
    last: bool
    """True for the last transfer of its block."""
    done: int = 0


class StreamPipe:
    """The bulk IN pipe: packets in order; a transfer of the host ends when it is full or at a short packet."""

    def __init__(self) -> None:
        self._transfers: deque[_Transfer] = deque()
        self.blocks = 0
        """Blocks that the host has not read to their end."""

    def send(self, block: Block, setup: Setup) -> None:
        """Queue a block."""
        self._put(block.leader(), True, False)
        data, reached = memoryview(block.payload), 0
        for length in setup.transfers():
            part = data[reached : reached + length]
            reached += len(part)
            self._put(part, len(part) < length, False)
        self._put(block.trailer(), True, True)
        self.blocks += 1

    def _put(self, data: bytes | memoryview, terminated: bool, last: bool) -> None:
        self._transfers.append(_Transfer(memoryview(data), terminated, last))

    def clear(self) -> None:
        """Drop all blocks."""
        self._transfers.clear()
        self.blocks = 0

    def read(self, buffer: memoryview, packet: int) -> tuple[int, bool]:
        """Fill ``buffer`` as far as there is data; returns the bytes and whether the host's transfer ends here."""
        filled = 0
        while self._transfers and filled < len(buffer):
            transfer = self._transfers[0]
            remaining = len(transfer.data) - transfer.done
            take = min(remaining, len(buffer) - filled)
            # The device sends whole packets: one that does not fit is babble, and the host's transfer fails.
            if take < remaining and take % packet:
                raise Overflow
            buffer[filled : filled + take] = transfer.data[transfer.done : transfer.done + take]
            filled += take
            transfer.done += take
            if take == remaining:
                short = len(transfer.data) % packet != 0
                full = filled == len(buffer)
                # A full last packet fills the buffer first; the empty packet behind it ends the host's next transfer.
                if transfer.terminated and not short and full and take:
                    transfer.data, transfer.done = memoryview(b""), 0
                    return filled, True
                self._transfers.popleft()
                self.blocks -= transfer.last
                if short or transfer.terminated:
                    return filled, True
        return filled, filled == len(buffer)
