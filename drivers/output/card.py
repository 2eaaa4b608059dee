"""One graphics card: the kernel's mode-setting calls as typed functions, and its flip reports.

Both heads of an instrument usually hang on one card and share its descriptor, perhaps from two threads: flip reports
are therefore sorted by their token, whichever thread reads them. Functions let ``OSError`` through; the head that made
the call knows its meaning (``head.py``).
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.api import CardNode, Clock
from drivers.output import drm

INTERRUPTED_TRIES = 16
PROBE_TRIES = 4
READ_SIZE = 4096
"""A read returns whole events; this is room for 128 of them."""


@dataclass(frozen=True, slots=True)
class Connector:
    """A connector of the card. ``properties`` maps property id → value."""

    id: int
    name: str
    connected: bool
    modes: tuple[drm.Mode, ...]
    encoders: tuple[int, ...]
    properties: Mapping[int, int]


@dataclass(frozen=True, slots=True)
class Property:
    """Property of a DRM object.

    ``choices`` maps the names of an enumerated property to values; empty for other kinds.
    """

    name: str
    choices: Mapping[str, int]


class Buffer:
    """A dumb XRGB8888 buffer that can be scanned out.

    ``pixels`` is (height, width, 4) uint8: blue, green, red, –.
    """

    def __init__(self, handle: int, framebuffer: int, memory: memoryview, size_px: tuple[int, int], pitch: int) -> None:
        width, height = size_px
        self.handle = handle
        self.framebuffer = framebuffer
        self._memory = memory
        rows: NDArray[np.uint8] = np.frombuffer(memory, np.uint8, pitch * height).reshape(height, pitch)
        # Lines may be longer than the picture (pitch): cut the padding off before splitting pixels.
        self.pixels = rows[:, : 4 * width].reshape(height, width, 4)

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Copy (height, width, 4) uint8 in, in memory order: scan-out memory is write-combined."""
        self.pixels[...] = pixels

    def unmap(self) -> None:
        self.pixels = np.empty((0, 0, 4), np.uint8)
        # A caller who still looks at the pixels keeps the mapping alive; it goes with the last reference.
        with contextlib.suppress(BufferError):
            self._memory.release()


class Card:
    """The calls on one card node, which it owns from now on."""

    def __init__(self, node: CardNode, clock: Clock) -> None:
        self._node = node
        self._clock = clock
        self._tokens = count(1)
        self._changed = threading.Condition()
        self._reading = False
        self._awaited: set[int] = set()
        self._arrived: dict[int, drm.FlipDone] = {}
        self._crtcs: tuple[int, ...] = ()
        self._connectors: tuple[int, ...] = ()

    def close(self) -> None:
        self._node.close()

    # ------------------------------------------------------------------------------ the card's parts

    def capability(self, capability: int) -> int:
        return int(self._call(drm.IOCTL_GET_CAP, drm.GET_CAP.pack(capability, 0), drm.GET_CAP)[1])

    def scan(self) -> None:
        """Read the lists of CRTCs and connectors. Raises OSError."""
        for _ in range(PROBE_TRIES):
            counts = self._call(drm.IOCTL_GET_RESOURCES, drm.CARD_RESOURCES.pack(*[0] * 12), drm.CARD_RESOURCES)[4:8]
            framebuffers, crtcs, connectors, encoders = (_U32s(n) for n in counts)
            again = self._call(
                drm.IOCTL_GET_RESOURCES,
                drm.CARD_RESOURCES.pack(
                    framebuffers.address, crtcs.address, connectors.address, encoders.address, *counts, 0, 0, 0, 0
                ),
                drm.CARD_RESOURCES,
            )[4:8]
            # If more ids than room: a device was plugged in meanwhile, and the kernel filled no list.
            if all(now <= room for now, room in zip(again, counts, strict=True)):
                self._crtcs, self._connectors = crtcs.values(again[1]), connectors.values(again[2])
                return
        raise OSError(errno.EAGAIN, f"the card's lists kept changing through {PROBE_TRIES} reads")

    @property
    def crtcs(self) -> tuple[int, ...]:
        return self._crtcs

    def connectors(self) -> list[Connector]:
        """Return every connector, from the kernel's memory (no probing). Raises OSError."""
        return [self.connector(connector) for connector in self._connectors]

    def connector(self, connector: int, probe: bool = False) -> Connector:
        """Return one connector; ``probe`` makes the driver check the wire (slow, needs mastery).

        Raises OSError.
        """
        room = self._connector_counts(connector, probe)
        for _ in range(PROBE_TRIES):
            modes_room, properties_room, encoders_room = room
            encoders, ids = _U32s(encoders_room), _U32s(properties_room)
            values = (ctypes.c_uint64 * max(1, properties_room))()
            # Without room for a mode the kernel would probe once more: always leave room for one.
            modes = ctypes.create_string_buffer(drm.MODE_INFO.size * max(1, modes_room))
            got = self._call(
                drm.IOCTL_GET_CONNECTOR,
                drm.GET_CONNECTOR.pack(
                    encoders.address, ctypes.addressof(modes), ids.address, ctypes.addressof(values),
                    max(1, modes_room), properties_room, encoders_room, 0, connector, *[0] * 7,
                ),
                drm.GET_CONNECTOR,
            )  # fmt: skip
            n_modes, n_properties, n_encoders = got[4:7]
            if n_modes <= max(1, modes_room) and n_properties <= properties_room and n_encoders <= encoders_room:
                size = drm.MODE_INFO.size
                return Connector(
                    id=connector,
                    name=drm.connector_name(got[9], got[10]),
                    connected=got[11] == drm.CONNECTED,
                    modes=tuple(drm.Mode.unpack(modes.raw[i * size : (i + 1) * size]) for i in range(n_modes)),
                    encoders=encoders.values(n_encoders),
                    properties=dict(zip(ids.values(n_properties), values[:n_properties], strict=True)),
                )
            room = (n_modes, n_properties, n_encoders)
        raise OSError(errno.EAGAIN, f"connector {connector} kept changing through {PROBE_TRIES} reads")

    def is_connected(self, connector: int) -> bool:
        """Return True if a device is plugged in, as far as the driver noticed. Cheap; raises OSError."""
        return bool(self._ask_connector(connector, probe=False)[11] == drm.CONNECTED)

    def possible_crtcs(self, connector: Connector) -> tuple[int, ...]:
        """Return the CRTCs that can drive a connector through one of its encoders, in the card's order.

        Raises OSError.
        """
        mask = 0
        for encoder in connector.encoders:
            mask |= self._call(drm.IOCTL_GET_ENCODER, drm.GET_ENCODER.pack(encoder, 0, 0, 0, 0), drm.GET_ENCODER)[3]
        return tuple(crtc for bit, crtc in enumerate(self._crtcs) if mask >> bit & 1)

    def property(self, property_id: int) -> Property:
        """Return a property's name and choices. Raises OSError."""
        layout = drm.GET_PROPERTY
        first = self._call(drm.IOCTL_GET_PROPERTY, layout.pack(0, 0, property_id, 0, b"", 0, 0), layout)
        name, n_values, n_choices = _text(first[4]), first[5], first[6]
        if not first[3] & drm.PROPERTY_IS_ENUM or not n_choices:
            return Property(name, {})
        values = (ctypes.c_uint64 * max(1, n_values))()
        entries = ctypes.create_string_buffer(drm.PROPERTY_ENUM.size * n_choices)
        self._call(
            drm.IOCTL_GET_PROPERTY,
            layout.pack(ctypes.addressof(values), ctypes.addressof(entries), property_id, 0, b"", n_values, n_choices),
            layout,
        )
        return Property(name, {_text(label): value for value, label in drm.PROPERTY_ENUM.iter_unpack(entries.raw)})

    def set_property(self, connector: int, property_id: int, value: int) -> None:
        self._call(drm.IOCTL_SET_PROPERTY, drm.SET_PROPERTY.pack(value, property_id, connector), drm.SET_PROPERTY)

    # ---------------------------------------------------------------------------------- buffers

    def create_buffer(self, width_px: int, height_px: int) -> Buffer:
        """Make a black buffer, mapped and registered for scan-out.

        Raises OSError after releasing all its parts.
        """
        _, _, _, _, handle, pitch, size = self._call(
            drm.IOCTL_CREATE_DUMB, drm.CREATE_DUMB.pack(height_px, width_px, 32, 0, 0, 0, 0), drm.CREATE_DUMB
        )
        with contextlib.ExitStack() as undo:
            undo.callback(self._call, drm.IOCTL_DESTROY_DUMB, drm.ID.pack(handle), drm.ID)
            framebuffer = self._call(
                drm.IOCTL_ADD_FRAMEBUFFER,
                drm.ADD_FRAMEBUFFER.pack(0, width_px, height_px, pitch, 32, 24, handle),
                drm.ADD_FRAMEBUFFER,
            )[0]
            undo.callback(self._call, drm.IOCTL_REMOVE_FRAMEBUFFER, drm.ID.pack(framebuffer), drm.ID)
            offset = self._call(drm.IOCTL_MAP_DUMB, drm.MAP_DUMB.pack(handle, 0, 0), drm.MAP_DUMB)[2]
            memory = self._node.map(size, offset)
            undo.pop_all()
        buffer = Buffer(handle, framebuffer, memory, (width_px, height_px), pitch)
        buffer.pixels[...] = 0
        return buffer

    def destroy_buffer(self, buffer: Buffer) -> None:
        """Give a buffer back. The kernel darkens a CRTC that still shows it. Raises OSError."""
        buffer.unmap()
        self._call(drm.IOCTL_REMOVE_FRAMEBUFFER, drm.ID.pack(buffer.framebuffer), drm.ID)
        self._call(drm.IOCTL_DESTROY_DUMB, drm.ID.pack(buffer.handle), drm.ID)

    # -------------------------------------------------------------------------- light and flips

    def light(self, crtc: int, connector: int, mode: drm.Mode, buffer: Buffer) -> None:
        """Set ``mode`` on ``connector`` and show ``buffer``. Raises OSError (EACCES, EPERM: not the master)."""
        ids = _U32s(1, connector)
        self._call(
            drm.IOCTL_SET_CRTC, drm.CRTC.pack(ids.address, 1, crtc, buffer.framebuffer, 0, 0, 0, 1, mode.raw), drm.CRTC
        )

    def darken(self, crtc: int) -> None:
        """Switch a CRTC off. Raises OSError."""
        self._call(drm.IOCTL_SET_CRTC, drm.CRTC.pack(0, 0, crtc, 0, 0, 0, 0, 0, b""), drm.CRTC)

    def linear_gamma(self, crtc: int) -> bool:
        """Load the identity into the CRTC's look-up table; False where it has none. Raises OSError."""
        size = self._call(drm.IOCTL_GET_CRTC, drm.CRTC.pack(0, 0, crtc, 0, 0, 0, 0, 0, b""), drm.CRTC)[6]
        if size < 2:
            return False
        # The kernel's tables have 16 bits; the last entry is full light.
        ramp = (ctypes.c_uint16 * size)(*(65535 * i // (size - 1) for i in range(size)))
        address = ctypes.addressof(ramp)
        self._call(drm.IOCTL_SET_GAMMA, drm.CRTC_LUT.pack(crtc, size, address, address, address), drm.CRTC_LUT)
        return True

    def submit_flip(self, crtc: int, buffer: Buffer) -> int:
        """Request ``buffer`` at the next vertical blank; return the token of its report.

        Raises OSError (EBUSY).
        """
        with self._changed:
            token = next(self._tokens)
            # Before the call: the report may be read by another thread before this one returns.
            self._awaited.add(token)
        try:
            self._call(
                drm.IOCTL_PAGE_FLIP,
                drm.PAGE_FLIP.pack(crtc, buffer.framebuffer, drm.PAGE_FLIP_EVENT, 0, token),
                drm.PAGE_FLIP,
            )
        except OSError:
            with self._changed:
                self._awaited.discard(token)
            raise
        return token

    def wait_flip(self, token: int, timeout_s: float) -> drm.FlipDone | None:
        """Return the report of a submitted flip; ``None`` after the timeout (it may still come).

        With several waiting threads one reads the node and hands the others their reports. Raises OSError, ValueError.
        """
        deadline_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        left_s = timeout_s
        with self._changed:
            # Two outputs share one node, and the kernel gives each report to one reader: one thread reads for all.
            while token not in self._arrived:
                self._await_reports(token, max(0.0, left_s))
                left_s = (deadline_ns - self._clock.now_ns()) * 1e-9
                if left_s <= 0.0:
                    break
            report = self._arrived.pop(token, None)
            if report is not None:
                self._awaited.discard(token)
            return report

    def forget_flip(self, token: int) -> None:
        """Drop the report of this flip when it comes."""
        with self._changed:
            self._awaited.discard(token)
            self._arrived.pop(token, None)

    def _await_reports(self, token: int, timeout_s: float) -> None:
        """Read reports, or wait for another thread that is reading them. Call with the lock held."""
        if self._reading:
            self._clock.wait_for(self._changed, lambda: token in self._arrived or not self._reading, timeout_s)
            return
        # The lock is released while the kernel is waited for, so that flips can be submitted meanwhile; ``_reading``
        # keeps a second reader out.
        self._reading = True
        self._changed.release()
        reports: Sequence[drm.FlipDone] = ()
        try:
            reports = self._read_reports(timeout_s)
        finally:
            self._changed.acquire()
            self._reading = False
            self._arrived.update({report.token: report for report in reports if report.token in self._awaited})
            self._changed.notify_all()

    def _read_reports(self, timeout_s: float) -> Sequence[drm.FlipDone]:
        if not self._node.wait_readable(timeout_s):
            return ()
        try:
            return drm.parse_events(self._node.read(READ_SIZE))
        except BlockingIOError:
            return ()

    # ------------------------------------------------------------------------------------ calls

    def _connector_counts(self, connector: int, probe: bool) -> tuple[int, int, int]:
        got = self._ask_connector(connector, probe)
        return got[4], got[5], got[6]

    def _ask_connector(self, connector: int, probe: bool) -> tuple[Any, ...]:
        # No room for modes makes the kernel probe.
        mode = ctypes.create_string_buffer(drm.MODE_INFO.size)
        pointer, room = (0, 0) if probe else (ctypes.addressof(mode), 1)
        layout = drm.GET_CONNECTOR
        request = layout.pack(0, pointer, 0, 0, room, 0, 0, 0, connector, *[0] * 7)
        return self._call(drm.IOCTL_GET_CONNECTOR, request, layout)

    def _call(self, request: int, argument: bytes, layout: Struct) -> tuple[Any, ...]:
        for tries_left in reversed(range(INTERRUPTED_TRIES)):
            buffer = bytearray(argument)
            try:
                self._node.ioctl(request, buffer)
            except OSError as error:
                if error.errno not in (errno.EINTR, errno.EAGAIN) or not tries_left:
                    raise
            else:
                return layout.unpack(buffer)
        raise AssertionError  # the last try returned or raised


class _U32s:
    """An array of ids for the kernel to read or fill."""

    def __init__(self, room: int, *values: int) -> None:
        self._array = (ctypes.c_uint32 * max(1, room))(*values)
        self.address = ctypes.addressof(self._array)

    def values(self, number: int) -> tuple[int, ...]:
        return tuple(self._array[:number])


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")
