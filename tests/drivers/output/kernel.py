"""A card as the kernel presents it, written from the user-space headers with their C types.

It decides nothing by itself: tests say what is plugged in, when flips are late, and when the card is pulled. Its
time is its own and advances from vertical blank to vertical blank.
"""

from __future__ import annotations

import ctypes
import errno
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERIOD_NS = 16_666_667
u16, u32, u64 = ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64


def structure(*fields: tuple[Any, str]) -> Any:
    """Return a C structure from the names of its fields by their types, in order."""
    listed = [(name, kind) for kind, names in fields for name in names.split()]
    return type("Structure", (ctypes.Structure,), {"_fields_": listed})


Name = ctypes.c_char * 32
ModeInfo = structure(
    (u32, "clock"),
    (u16, "hdisplay hsync_start hsync_end htotal hskew vdisplay vsync_start vsync_end vtotal vscan"),
    (u32, "vrefresh flags type"),
    (Name, "name"),
)
CardRes = structure(
    (u64, "fb_ptr crtc_ptr connector_ptr encoder_ptr"),
    (u32, "fbs crtcs connectors encoders min_w max_w min_h max_h"),
)
Crtc = structure(
    (u64, "connectors_ptr"), (u32, "connectors crtc_id fb_id x y gamma_size mode_valid"), (ModeInfo, "mode")
)
GetEncoder = structure((u32, "id type crtc_id possible_crtcs possible_clones"))
GetConnector = structure(
    (u64, "encoders_ptr modes_ptr props_ptr values_ptr"),
    (u32, "modes props encoders encoder_id id type type_id connection mm_w mm_h subpixel pad"),
)
GetProperty = structure((u64, "values_ptr enum_ptr"), (u32, "id flags"), (Name, "name"), (u32, "values enums"))
PropertyEnum = structure((u64, "value"), (Name, "name"))
SetProperty = structure((u64, "value"), (u32, "id connector"))
FbCmd = structure((u32, "fb_id width height pitch bpp depth handle"))
PageFlip = structure((u32, "crtc_id fb_id flags reserved"), (u64, "user_data"))
CreateDumb = structure((u32, "height width bpp flags handle pitch"), (u64, "size"))
MapDumb = structure((u32, "handle pad"), (u64, "offset"))
GetCap = structure((u64, "capability value"))
CrtcLut = structure((u32, "crtc_id size"), (u64, "red green blue"))
VblankEvent = structure((u32, "type length"), (u64, "user_data"), (u32, "sec usec sequence crtc_id"))


@dataclass
class Plug:
    """A connector: its number, name parts, what is plugged in, and which CRTCs its encoder reaches."""

    id: int
    type: int
    type_id: int
    modes: list[Any] = field(default_factory=list)
    possible_crtcs: int = 0b11
    connected: bool = True
    properties: dict[int, int] = field(default_factory=dict)


def plugged(*plugs: Plug, **more: Any) -> Kernel:
    return Kernel({plug.id: plug for plug in plugs}, **more)


def mode(width: int, height: int, hz: float = 60.0) -> Any:
    htotal, vtotal = width + 160, height + 30
    return ModeInfo(
        clock=round(htotal * vtotal * hz / 1000), hdisplay=width, htotal=htotal, vdisplay=height, vtotal=vtotal,
        vrefresh=round(hz), name=f"{width}x{height}".encode(),
    )  # fmt: skip


class Time:
    """A clock that only moves when somebody waits."""

    def __init__(self) -> None:
        self.ns = 5_000_000_000

    def now_ns(self) -> int:
        return self.ns

    def sleep_s(self, duration_s: float) -> None:
        self.ns += round(duration_s * 1e9)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return condition.wait_for(predicate, timeout_s)


def refusing(number: int = errno.EINVAL, times: float = math.inf) -> Callable[[bytearray], None]:
    """Return what refuses the first so many requests."""
    left = times

    def refuse(buffer: bytearray) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            buffer[:] = b"\xff" * len(buffer)  # what is half done may lie in the request
            raise OSError(number, "it cannot be done")

    return refuse


@dataclass
class Kernel:
    plugs: dict[int, Plug]
    crtc_ids: list[int] = field(default_factory=lambda: [40, 50])
    pitch_align: int = 256
    time: Time = field(default_factory=Time)
    counts_blanks: bool = True
    throttles: bool = True
    monotonic: int = 1
    dumb_buffers: int = 1
    unnoticed: set[int] = field(default_factory=set)
    """Connectors whose cable was plugged in while nobody looked at the wire."""
    gamma_size: int = 256
    properties: dict[int, tuple[str, int, dict[str, int]]] = field(default_factory=dict)
    busy: int = 0
    pulled: bool = False
    mute: bool = False
    master: bool = True
    on_blank: Callable[[Kernel], None] = lambda kernel: None
    before: dict[int, Callable[[bytearray], None]] = field(default_factory=dict)
    """What happens before a request of this number is dealt with."""
    blank: int = 1000
    flips: int = 0
    closed: bool = False
    events: bytes = b""
    calls: list[int] = field(default_factory=list)
    memory: dict[int, bytearray] = field(default_factory=dict)
    dumb: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    fbs: dict[int, int] = field(default_factory=dict)
    lit: dict[int, int] = field(default_factory=dict)
    gamma: dict[int, list[int]] = field(default_factory=dict)
    pending: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    _next: int = 100
    _lock: threading.RLock = field(default_factory=threading.RLock)

    # -- what a test looks at

    def picture(self, crtc: int) -> NDArray[np.uint8]:
        """(height, width, 4) as it would light the screen of ``crtc``: blue, green, red, unused."""
        handle = self.fbs[self.lit[crtc]]
        width, height, pitch = self.dumb[handle]
        rows = np.frombuffer(self.memory[handle], np.uint8)[: pitch * height].reshape(height, pitch)
        return rows[:, : 4 * width].reshape(height, width, 4).copy()

    # -- the five calls

    def ioctl(self, request: int, buffer: bytearray) -> None:
        with self._lock:
            number = request & 0xFF
            assert not self.closed, "that descriptor may be somebody else's by now"
            assert request >> 30 == 3
            assert request >> 8 & 0xFF == ord("d")
            assert request >> 16 & 0x3FFF == len(buffer)
            self.calls.append(number)
            if self.pulled:
                raise OSError(errno.ENODEV, "No such device")
            if number in self.before:
                self.before[number](buffer)
            # What a call does not ask by is 0: a kernel may give any of it a meaning in a later version.
            handlers: dict[int, tuple[Callable[[Any], object], Any, str]] = {
                0x0C: (self._get_cap, GetCap, "value"),
                0xA0: (self._resources, CardRes, "min_w max_w min_h max_h"),
                0xA1: (self._get_crtc, Crtc, "connectors_ptr connectors fb_id x y gamma_size mode_valid"),
                0xA2: (self._set_crtc, Crtc, "gamma_size x y"),
                0xA5: (self._set_gamma, CrtcLut, ""),
                0xA6: (self._encoder, GetEncoder, "type crtc_id possible_crtcs possible_clones"),
                0xA7: (self._connector, GetConnector, "encoder_id type type_id connection mm_w mm_h subpixel pad"),
                0xAA: (self._get_property, GetProperty, "flags"),
                0xAB: (self._set_property, SetProperty, ""),
                0xAE: (self._add_fb, FbCmd, "fb_id"),
                0xAF: (lambda fb: self._rm_fb(fb.value), u32, ""),
                0xB0: (self._flip, PageFlip, "reserved"),
                0xB2: (self._create, CreateDumb, "flags handle pitch size"),
                0xB3: (self._map, MapDumb, "pad offset"),
                0xB4: (lambda handle: self.dumb.pop(handle.value), u32, ""),
            }
            if number not in handlers:
                raise OSError(errno.EINVAL, "Invalid argument")
            function, layout, zeros = handlers[number]
            asked = layout.from_buffer(buffer)
            assert not any(getattr(asked, name) for name in zeros.split()), (hex(number), zeros)
            function(asked)

    def map(self, length: int, offset: int) -> memoryview:
        memory = self.memory[offset >> 12]
        assert len(memory) == length
        return memoryview(memory)

    def read(self, size: int) -> bytes:
        with self._lock:
            if self.pulled:
                raise OSError(errno.ENODEV, "No such device")
            if not self.events:
                raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
            whole = size // ctypes.sizeof(VblankEvent) * ctypes.sizeof(VblankEvent)
            data, self.events = self.events[:whole], self.events[whole:]
            return data

    def wait_readable(self, timeout_s: float) -> bool:
        with self._lock:
            deadline_ns = self.time.ns + round(timeout_s * 1e9)
            while not self.events and not self.pulled:
                next_ns = self.time.ns + PERIOD_NS if self.throttles else self.time.ns + 20_000
                if next_ns > deadline_ns:
                    self.time.ns = max(self.time.ns, deadline_ns)
                    return False
                self.time.ns = next_ns
                self._vertical_blank()
            return True

    def close(self) -> None:
        self.closed = True

    # -- time

    def _vertical_blank(self) -> None:
        self.blank += 1
        self.on_blank(self)
        for crtc, (fb, user_data, due) in list(self.pending.items()):
            if self.blank < due or self.mute:
                continue
            del self.pending[crtc]
            self.lit[crtc] = fb
            seconds, microseconds = self.time.ns // 10**9, self.time.ns // 1000 % 10**6
            count = self.blank % 2**32 if self.counts_blanks else 0
            self.events += bytes(VblankEvent(2, 32, user_data, seconds, microseconds, count, crtc))

    # -- requests

    def _get_cap(self, cap: Any) -> None:
        cap.value = {1: self.dumb_buffers, 6: self.monotonic, 0x12: 1}.get(cap.capability, 0)

    def _resources(self, res: Any) -> None:
        for name, there in (
            ("fb", [*self.fbs]),
            ("crtc", self.crtc_ids),
            ("connector", [*self.plugs]),
            ("encoder", [plug + 1000 for plug in self.plugs]),
        ):
            assert getattr(res, f"{name}_ptr") or not getattr(res, f"{name}s"), "room for ids at no address"
            self._fill(res, f"{name}_ptr", f"{name}s", there, u32)
        res.max_w = res.max_h = 4096

    def _encoder(self, enc: Any) -> None:
        enc.possible_crtcs = self.plugs[enc.id - 1000].possible_crtcs

    def _connector(self, con: Any) -> None:
        if con.id not in self.plugs:
            raise OSError(errno.ENOENT, "No such file or directory")
        plug = self.plugs[con.id]
        if not con.modes:
            self.unnoticed.discard(con.id)  # room for no mode at all: the driver looks at the wire
        connected = plug.connected and con.id not in self.unnoticed
        con.type, con.type_id, con.connection = plug.type, plug.type_id, 1 if connected else 2
        self._fill(con, "modes_ptr", "modes", plug.modes if connected else [], ModeInfo)
        if con.props >= len(plug.properties) and con.values_ptr:
            (u64 * len(plug.properties)).from_address(con.values_ptr)[:] = list(plug.properties.values())
        self._fill(con, "props_ptr", "props", [*plug.properties], u32)
        self._fill(con, "encoders_ptr", "encoders", [plug.id + 1000], u32)

    def _get_property(self, prop: Any) -> None:
        assert prop.name == b""
        name, flags, choices = self.properties[prop.id]
        prop.name, prop.flags = name.encode(), flags
        self._fill(prop, "values_ptr", "values", [*choices.values()], u64)
        self._fill(prop, "enum_ptr", "enums", [PropertyEnum(v, n.encode()) for n, v in choices.items()], PropertyEnum)

    def _set_property(self, prop: Any) -> None:
        self.plugs[prop.connector].properties[prop.id] = prop.value

    def _create(self, dumb: Any) -> None:
        assert dumb.bpp == 32
        pitch = -(-4 * dumb.width // self.pitch_align) * self.pitch_align
        dumb.handle, dumb.pitch, dumb.size = self._number(), pitch, -(-pitch * dumb.height // 4096) * 4096
        self.memory[dumb.handle] = bytearray(b"\x5a" * dumb.size)  # dirty: black must be written
        self.dumb[dumb.handle] = (dumb.width, dumb.height, pitch)

    def _map(self, request: Any) -> None:
        assert request.handle in self.dumb
        request.offset = request.handle << 12

    def _add_fb(self, fb: Any) -> None:
        assert self.dumb[fb.handle] == (fb.width, fb.height, fb.pitch)
        assert (fb.bpp, fb.depth) == (32, 24)
        fb.fb_id = self._number()
        self.fbs[fb.fb_id] = fb.handle

    def _rm_fb(self, fb: int) -> None:
        del self.fbs[fb]
        self.lit = {crtc: shown for crtc, shown in self.lit.items() if shown != fb}

    def _get_crtc(self, crtc: Any) -> None:
        assert crtc.crtc_id in self.crtc_ids
        crtc.gamma_size = self.gamma_size

    def _set_gamma(self, lut: Any) -> None:
        assert lut.size == self.gamma_size
        red, green, blue = ((u16 * lut.size).from_address(one)[:] for one in (lut.red, lut.green, lut.blue))
        assert red == green == blue
        self.gamma[lut.crtc_id] = green

    def _set_crtc(self, crtc: Any) -> None:
        if not self.master:
            raise OSError(errno.EACCES, "Permission denied")
        if not crtc.mode_valid:
            assert (crtc.connectors_ptr, crtc.connectors, crtc.fb_id) == (0, 0, 0)
            assert bytes(crtc.mode) == bytes(ModeInfo())
            self.lit.pop(crtc.crtc_id, None)
            return
        assert crtc.mode_valid == 1
        (connector,) = (u32 * crtc.connectors).from_address(crtc.connectors_ptr)
        plug = self.plugs[connector]
        assert plug.possible_crtcs >> self.crtc_ids.index(crtc.crtc_id) & 1
        assert bytes(crtc.mode) in [bytes(m) for m in plug.modes]
        width, height, _ = self.dumb[self.fbs[crtc.fb_id]]
        assert (width, height) == (crtc.mode.hdisplay, crtc.mode.vdisplay)
        self.lit[crtc.crtc_id] = crtc.fb_id

    def _flip(self, flip: Any) -> None:
        assert flip.flags == 1
        assert flip.fb_id in self.fbs
        if self.busy or flip.crtc_id in self.pending:
            self.busy = max(0, self.busy - 1)
            raise OSError(errno.EBUSY, "Device or resource busy")
        self.flips += 1
        self.pending[flip.crtc_id] = (flip.fb_id, flip.user_data, self.blank + 1)

    @staticmethod
    def _fill(owner: ctypes.Structure, pointer: str, number: str, values: list[Any], kind: Any) -> None:
        room, address = getattr(owner, number), getattr(owner, pointer)
        if values and room >= len(values) and address:
            (kind * len(values)).from_address(address)[:] = values
        setattr(owner, number, len(values))

    def _number(self) -> int:
        self._next += 1
        return self._next


@dataclass
class KernelWires:
    """``drivers.api.Wires`` with this kernel behind ``open_card``."""

    kernels: dict[str, list[Kernel | Exception]]
    opened: list[str] = field(default_factory=list)
    usb_backend: object = None
    hidraw: object = None

    @property
    def clock(self) -> Time:
        return next(one for queue in self.kernels.values() for one in queue if isinstance(one, Kernel)).time

    def open_card(self, path: str) -> Kernel:
        """The next kernel in the queue of that path; the last one again and again."""
        self.opened.append(path)
        queue = self.kernels[path]
        found = queue.pop(0) if len(queue) > 1 else queue[0]
        if isinstance(found, Exception):
            raise found
        return found
