"""One opened node of the graphics card: system calls with the kernel's rules.

Two-call counts, master, one pending flip, events. All calls with the world's lock held.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import struct
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from hw_sim.devices import drm_abi as abi
from hw_sim.devices.card import Card
from hw_sim.devices.head import (
    GAMMA_SIZE,
    Connector,
    Crtc,
    Dumb,
    Flip,
    Framebuffer,
    Output,
    copy_mode,
    same_timing,
)

LARGEST = 4096
PAGE = 4096
EVENT_SPACE = 4096
ENCODERS = {Output.PROJECTOR: 94, Output.DISPLAY: 102}
PROP_DPMS, PROP_BROADCAST_RGB = 2, 104
PROPERTIES: dict[int, tuple[str, tuple[str, ...]]] = {
    PROP_DPMS: ("DPMS", ("On", "Standby", "Suspend", "Off")),
    PROP_BROADCAST_RGB: ("Broadcast RGB", ("Automatic", "Full", "Limited 16:235")),
}
CAPS = {
    abi.CAP_DUMB_BUFFER: 1,
    abi.CAP_VBLANK_HIGH_CRTC: 1,
    abi.CAP_DUMB_PREFERRED_DEPTH: 24,
    abi.CAP_PREFER_SHADOW: 1,
    abi.CAP_PRIME: 3,
    abi.CAP_TIMESTAMP_MONOTONIC: 1,
    abi.CAP_ASYNC_PAGE_FLIP: 0,
    abi.CAP_CURSOR_WIDTH: 64,
    abi.CAP_CURSOR_HEIGHT: 64,
    abi.CAP_ADDFB2_MODIFIERS: 0,
    abi.CAP_CRTC_IN_VBLANK_EVENT: 1,
}
MASTER_ONLY = (abi.SETCRTC, abi.SETGAMMA, abi.PAGE_FLIP, abi.DIRTYFB, abi.SETPROPERTY, abi.OBJ_SETPROPERTY)
DRIVER = (b"kfsim", b"20240101", b"simulated display card")


class UserMemory(Protocol):
    """Memory of the calling process by address; raises OSError(EFAULT) for an invalid one."""

    def copy_to_user(self, address: int, data: bytes) -> None: ...

    def copy_from_user(self, address: int, size: int) -> bytes: ...


class Host(Protocol):
    """The machine of the card: its memory and clock."""

    @property
    def memory(self) -> UserMemory:
        """Memory of the process that opened the node, if a call names no other."""

    def time_ns(self, world_ns: int) -> int:
        """Return a moment of world time by the host's monotonic clock."""

    def scan_out_memory(self, size: int) -> tuple[bytearray | memoryview, int]:
        """Return memory for a dumb buffer, zero, and the offset of the node at which it can be mapped."""


class ThisProcess:
    """The host is this process, and its clock is the world's."""

    def __init__(self) -> None:
        self._offsets = itertools.count(0x1_0000_0000, 1 << 28)

    @property
    def memory(self) -> UserMemory:
        return abi.OwnMemory()

    def time_ns(self, world_ns: int) -> int:
        return world_ns

    def scan_out_memory(self, size: int) -> tuple[bytearray | memoryview, int]:
        return bytearray(size), next(self._offsets)


Struct = TypeVar("Struct", bound=ctypes.Structure)


def _fail(number: int) -> OSError:
    return OSError(number, os.strerror(number))


class CardFile:
    """One opened node. ``ioctl`` raises OSError as the system call does."""

    def __init__(self, card: Card, host: Host | None = None) -> None:
        self._card, self._notify, self._host = card, card.notify, host or ThisProcess()
        self._user: UserMemory = self._host.memory
        self._dumbs: dict[int, Dumb] = {}
        self._offsets: dict[int, Dumb] = {}
        self._handles = itertools.count(1)
        self._events: deque[bytes] = deque()
        self._promised = 0
        """Events that were asked for and have not happened."""
        self._closed = False
        self._cut = False
        card.opened(self)
        self._calls: dict[int, Callable[[bytearray], None]] = {
            abi.VERSION: self._version,
            abi.GET_CAP: self._get_cap,
            abi.SET_CLIENT_CAP: self._set_client_cap,
            abi.SET_MASTER: self._set_master,
            abi.DROP_MASTER: self._drop_master,
            abi.GETRESOURCES: self._get_resources,
            abi.GETCRTC: self._get_crtc,
            abi.SETCRTC: self._set_crtc,
            abi.GETGAMMA: self._get_gamma,
            abi.SETGAMMA: self._set_gamma,
            abi.GETENCODER: self._get_encoder,
            abi.GETCONNECTOR: self._get_connector,
            abi.GETPROPERTY: self._get_property,
            abi.SETPROPERTY: self._set_connector_property,
            abi.ADDFB: self._add_fb,
            abi.RMFB: self._remove_fb,
            abi.PAGE_FLIP: self._page_flip,
            abi.DIRTYFB: self._dirty_fb,
            abi.CREATE_DUMB: self._create_dumb,
            abi.MAP_DUMB: self._map_dumb,
            abi.DESTROY_DUMB: self._destroy_dumb,
            abi.OBJ_GETPROPERTIES: self._get_object_properties,
            abi.OBJ_SETPROPERTY: self._set_object_property,
        }

    # ------------------------------------------------------------------------------------------ system calls

    def ioctl(self, request: int, buffer: bytearray, user: UserMemory | None = None) -> None:
        """Do the same as ``fcntl.ioctl(fd, request, buffer, True)``.

        Pointers lead into ``user``, by default the host's memory.
        """
        self._check_open()
        self._user = user or self._host.memory
        if request >> 8 & 0xFF != abi.IOCTL_TYPE:
            raise _fail(errno.ENOTTY)
        # _IOC of asm-generic/ioctl.h: number in bits 0..7, type in 8..15, size in 16..29.
        number, size = request & 0xFF, request >> 16 & 0x3FFF
        call = self._calls.get(number)
        if call is None:
            raise _fail(errno.EINVAL)
        if len(buffer) < size:
            raise _fail(errno.EFAULT)
        if number in MASTER_ONLY and not self._is_master:
            raise _fail(errno.EACCES)
        call(buffer)

    def map(self, length: int, offset: int) -> memoryview:
        """Return the memory of a dumb buffer, writable and shared, as ``mmap`` does."""
        self._check_open()
        dumb = self._offsets.get(offset)
        if dumb is None or not 0 < length <= len(dumb.memory):
            raise _fail(errno.EINVAL)
        return memoryview(dumb.memory)[:length]

    @property
    def readable(self) -> bool:
        """True if an event can be read."""
        return bool(self._events)

    @property
    def closed(self) -> bool:
        """True after ``close``."""
        return self._closed

    def read(self, size: int) -> bytes:
        """Return whole events, as ``os.read`` of a non-blocking descriptor does. Raises BlockingIOError without one."""
        self._check_open()
        if not self._events:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        data = b""
        while self._events and len(data) + len(self._events[0]) <= size:
            data += self._events.popleft()
        return data

    def close(self) -> None:
        """Release all resources. The last file leaves the card to the console."""
        if self._closed:
            return
        self._closed = True
        self._card.released(self)
        self._notify()

    def cut(self) -> None:
        """Fail every call from now on: the card is removed."""
        self._cut = True

    def deliver(self, user_data: int, time_ns: int, crtc: Crtc) -> None:
        """Queue the event of a flip that has completed."""
        # struct drm_event_vblank has the time of the blank, not of the delivery.
        seconds, microseconds = divmod(self._host.time_ns(time_ns) // 1000, 1_000_000)
        event = (abi.EVENT_FLIP_COMPLETE, abi.FLIP_COMPLETE.size, user_data, seconds, microseconds)
        self._promised -= 1
        if not self._closed:
            self._events.append(abi.FLIP_COMPLETE.pack(*event, crtc.sequence, crtc.crtc_id))
            self._notify()

    def _check_open(self) -> None:
        if self._closed:
            raise _fail(errno.EBADF)
        if self._cut:
            raise _fail(errno.ENODEV)

    @property
    def _is_master(self) -> bool:
        return self._card.master is self

    # ------------------------------------------------------------------------------------------ who may what

    def _version(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Version)
        arg.major, arg.minor, arg.patch = 1, 0, 0
        for name, text in zip(("name", "date", "desc"), DRIVER, strict=True):
            room = getattr(arg, f"{name}_len")
            if getattr(arg, name):
                self._user.copy_to_user(getattr(arg, name), text[:room])
            setattr(arg, f"{name}_len", len(text))
        _into(buffer, arg)

    def _get_cap(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Cap)
        if arg.capability not in CAPS:
            raise _fail(errno.EINVAL)
        arg.value = CAPS[arg.capability]
        _into(buffer, arg)

    def _set_client_cap(self, buffer: bytearray) -> None:
        # No planes, no atomic: the card has neither.
        raise _fail(errno.EOPNOTSUPP)

    def _set_master(self, buffer: bytearray) -> None:
        if self._card.master not in (None, self):
            raise _fail(errno.EBUSY)
        self._card.master = self

    def _drop_master(self, buffer: bytearray) -> None:
        if not self._is_master:
            raise _fail(errno.EINVAL)
        self._card.master = None

    # ------------------------------------------------------------------------------------------ what there is

    def _get_resources(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Resources)
        fbs = [i for i, (owner, _) in self._card.framebuffers.items() if owner is self]
        arg.count_fbs = self._fill(arg.fb_id_ptr, arg.count_fbs, fbs)
        arg.count_crtcs = self._fill(arg.crtc_id_ptr, arg.count_crtcs, list(self._card.crtcs))
        arg.count_connectors = self._fill(arg.connector_id_ptr, arg.count_connectors, list(self._card.connectors))
        arg.count_encoders = self._fill(arg.encoder_id_ptr, arg.count_encoders, list(ENCODERS.values()))
        arg.min_width, arg.max_width, arg.min_height, arg.max_height = 0, LARGEST, 0, LARGEST
        _into(buffer, arg)

    def _get_encoder(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Encoder)
        if arg.encoder_id not in ENCODERS.values():
            raise _fail(errno.ENOENT)
        crtc = next(c.crtc for c in self._card.connectors.values() if c.encoder_id == arg.encoder_id)
        arg.encoder_type = abi.ENCODER_TMDS
        arg.crtc_id = crtc.crtc_id if crtc else 0
        arg.possible_crtcs = (1 << len(self._card.crtcs)) - 1
        arg.possible_clones = 0
        _into(buffer, arg)

    def _get_connector(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ModeGetConnector)
        connector = self._card.connectors.get(arg.connector_id)
        if connector is None:
            raise _fail(errno.ENOENT)
        modes = self._card.modes[connector.output]
        # As in the kernel: modes and encoders are copied completely or not at all, properties as far as there is room.
        if arg.count_modes >= len(modes):
            self._user.copy_to_user(arg.modes_ptr, b"".join(bytes(mode) for mode in modes))
        if arg.count_encoders >= 1:
            self._user.copy_to_user(arg.encoders_ptr, struct.pack("<I", connector.encoder_id))
        properties = _properties(connector)
        self._fill(arg.props_ptr, arg.count_props, list(properties))
        arg.count_props = self._fill(arg.prop_values_ptr, arg.count_props, list(properties.values()), "Q")
        arg.count_modes, arg.count_encoders = len(modes), 1
        arg.encoder_id = connector.encoder_id if connector.crtc else 0
        arg.connector_type, arg.connector_type_id = connector.kind, connector.kind_number
        arg.connection, arg.subpixel = abi.CONNECTED, abi.SUBPIXEL_UNKNOWN
        arg.mm_width, arg.mm_height = connector.size_mm
        _into(buffer, arg)

    def _get_crtc(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ModeCrtc)
        crtc = self._crtc(arg.crtc_id)
        arg.x, arg.y = crtc.offset
        arg.gamma_size = GAMMA_SIZE
        arg.fb_id = crtc.framebuffer.fb_id if crtc.framebuffer else 0
        arg.mode_valid = int(crtc.mode is not None)
        if crtc.mode is not None:
            arg.mode = crtc.mode
        _into(buffer, arg)

    # ------------------------------------------------------------------------------------------ properties

    def _get_property(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Property)
        if arg.prop_id not in PROPERTIES:
            raise _fail(errno.ENOENT)
        name, choices = PROPERTIES[arg.prop_id]
        arg.name, arg.flags = name.encode(), abi.PROP_ENUM
        arg.count_values = self._fill(arg.values_ptr, arg.count_values, list(range(len(choices))), "Q")
        entries = [abi.PropertyEnum(value, choice.encode()) for value, choice in enumerate(choices)]
        if arg.count_enum_blobs >= len(entries):
            self._user.copy_to_user(arg.enum_blob_ptr, b"".join(bytes(entry) for entry in entries))
        arg.count_enum_blobs = len(entries)
        _into(buffer, arg)

    def _get_object_properties(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ObjectProperties)
        properties = _properties(self._connector(arg.obj_id, arg.obj_type, arg.obj_id in self._card.crtcs))
        self._fill(arg.props_ptr, arg.count_props, list(properties))
        arg.count_props = self._fill(arg.prop_values_ptr, arg.count_props, list(properties.values()), "Q")
        _into(buffer, arg)

    def _set_connector_property(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ConnectorSetProperty)
        self._set_property(self._connector(arg.connector_id, abi.OBJECT_CONNECTOR), arg.prop_id, arg.value)

    def _set_object_property(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ObjectSetProperty)
        self._set_property(self._connector(arg.obj_id, arg.obj_type), arg.prop_id, arg.value)

    def _connector(self, object_id: int, object_type: int, is_crtc: bool = False) -> Connector | None:
        """Return the connector of that number; ``None`` for an engine, which has no properties."""
        if is_crtc and object_type in (abi.OBJECT_CRTC, abi.OBJECT_ANY):
            return None
        connector = self._card.connectors.get(object_id)
        if connector is None or object_type not in (abi.OBJECT_CONNECTOR, abi.OBJECT_ANY):
            raise _fail(errno.ENOENT)
        return connector

    def _set_property(self, connector: Connector | None, property_id: int, value: int) -> None:
        if connector is None or property_id not in _properties(connector):
            raise _fail(errno.ENOENT)
        if value >= len(PROPERTIES[property_id][1]):
            raise _fail(errno.EINVAL)
        if property_id == PROP_DPMS:
            connector.dpms = value
            # A sleeping monitor has no vertical blanks, so a pending flip must not wait for one.
            if value != abi.DPMS_ON and connector.crtc is not None:
                self._card.complete(connector.crtc)
        else:
            connector.broadcast_rgb = value

    # ------------------------------------------------------------------------------------------ buffers

    def _create_dumb(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.CreateDumb)
        if not (arg.width and arg.height and arg.bpp) or arg.width > 8 * LARGEST or arg.height > 8 * LARGEST:
            raise _fail(errno.EINVAL)
        arg.pitch = (arg.width * ((arg.bpp + 7) // 8) + 63) // 64 * 64
        arg.size = (arg.pitch * arg.height + PAGE - 1) // PAGE * PAGE
        arg.handle = next(self._handles)
        self._dumbs[arg.handle] = Dumb(arg.pitch, *self._host.scan_out_memory(arg.size))
        _into(buffer, arg)

    def _map_dumb(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.MapDumb)
        dumb = self._dumb(arg.handle)
        arg.offset = dumb.offset
        self._offsets[arg.offset] = dumb
        _into(buffer, arg)

    def _destroy_dumb(self, buffer: bytearray) -> None:
        handle = _from(buffer, abi.U32).value
        dumb = self._dumb(handle)
        del self._dumbs[handle]
        self._offsets = {offset: mapped for offset, mapped in self._offsets.items() if mapped is not dumb}

    def _dumb(self, handle: int) -> Dumb:
        try:
            return self._dumbs[handle]
        except KeyError:
            raise _fail(errno.ENOENT) from None

    def _add_fb(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.Fb)
        if (arg.bpp, arg.depth) != (32, 24) or not 0 < arg.width <= LARGEST or not 0 < arg.height <= LARGEST:
            raise _fail(errno.EINVAL)
        dumb = self._dumb(arg.handle)
        if arg.pitch < 4 * arg.width or arg.pitch * arg.height > len(dumb.memory):
            raise _fail(errno.EINVAL)
        arg.fb_id = self._card.next_id()
        framebuffer = Framebuffer(arg.fb_id, arg.width, arg.height, arg.pitch, arg.depth, dumb)
        self._card.framebuffers[arg.fb_id] = (self, framebuffer)
        _into(buffer, arg)

    def _remove_fb(self, buffer: bytearray) -> None:
        fb_id = _from(buffer, abi.U32).value
        if fb_id not in self._card.framebuffers or self._card.framebuffers[fb_id][0] is not self:
            raise _fail(errno.ENOENT)
        self._card.remove_framebuffer(fb_id)

    def _dirty_fb(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.DirtyFb)
        framebuffer = self._framebuffer(arg.fb_id)
        if not self._card.copies:  # a driver that scans out what user space writes has nothing to do, and no such call
            raise _fail(errno.ENOSYS)
        for crtc in self._card.crtcs.values():
            if crtc.framebuffer is framebuffer:
                self._card.look_at(crtc)

    def _framebuffer(self, fb_id: int) -> Framebuffer:
        if fb_id not in self._card.framebuffers:
            raise _fail(errno.ENOENT)
        return self._card.framebuffers[fb_id][1]

    # ------------------------------------------------------------------------------------------ scan-out

    def _crtc(self, crtc_id: int) -> Crtc:
        if crtc_id not in self._card.crtcs:
            raise _fail(errno.ENOENT)
        return self._card.crtcs[crtc_id]

    def _set_crtc(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.ModeCrtc)
        crtc = self._crtc(arg.crtc_id)
        if not arg.mode_valid:
            if arg.count_connectors:
                raise _fail(errno.EINVAL)
            self._card.switch_off(crtc)
            return
        if not 0 < arg.count_connectors <= len(self._card.connectors):
            raise _fail(errno.EINVAL)
        framebuffer = crtc.framebuffer if arg.fb_id == 0xFFFFFFFF else self._framebuffer(arg.fb_id)
        if framebuffer is None:
            raise _fail(errno.EINVAL)
        _check_viewport(framebuffer, arg.mode, (arg.x, arg.y))
        size = 4 * arg.count_connectors
        ids = struct.unpack(f"<{arg.count_connectors}I", self._user.copy_from_user(arg.set_connectors_ptr, size))
        connectors = [self._connector(i, abi.OBJECT_CONNECTOR) for i in ids]
        for connector in connectors:
            if connector is None or not any(same_timing(arg.mode, mode) for mode in self._card.modes[connector.output]):
                raise _fail(errno.EINVAL)
        self._card.switch_off(crtc)
        crtc.mode, crtc.framebuffer, crtc.offset = copy_mode(arg.mode), framebuffer, (arg.x, arg.y)
        self._card.look_at(crtc)
        for connector in connectors:
            if connector is not None:
                self._card.connect(connector, crtc)

    def _get_gamma(self, buffer: bytearray) -> None:
        arg, crtc = self._gamma_of(buffer)
        for address, table in zip((arg.red, arg.green, arg.blue), crtc.gamma, strict=True):
            self._user.copy_to_user(address, table.astype("<u2").tobytes())

    def _set_gamma(self, buffer: bytearray) -> None:
        arg, crtc = self._gamma_of(buffer)
        tables = [self._user.copy_from_user(address, 2 * GAMMA_SIZE) for address in (arg.red, arg.green, arg.blue)]
        crtc.gamma = np.array([np.frombuffer(table, "<u2") for table in tables], np.uint16)

    def _gamma_of(self, buffer: bytearray) -> tuple[abi.CrtcLut, Crtc]:
        arg = _from(buffer, abi.CrtcLut)
        crtc = self._crtc(arg.crtc_id)
        if arg.gamma_size != GAMMA_SIZE:
            raise _fail(errno.EINVAL)
        return arg, crtc

    def _page_flip(self, buffer: bytearray) -> None:
        arg = _from(buffer, abi.PageFlip)
        if arg.flags & ~abi.FLIP_EVENT or arg.reserved:
            raise _fail(errno.EINVAL)
        crtc = self._crtc(arg.crtc_id)
        if crtc.mode is None:
            raise _fail(errno.EBUSY)
        framebuffer = self._framebuffer(arg.fb_id)
        _check_viewport(framebuffer, crtc.mode, crtc.offset)
        # Without a vertical blank the flip would never complete: atomic helpers refuse it.
        if not self._card.lit(crtc):
            raise _fail(errno.EINVAL)
        if crtc.pending is not None:
            raise _fail(errno.EBUSY)
        wants_event = bool(arg.flags & abi.FLIP_EVENT)
        if wants_event:
            # drm_event_reserve_init: an event needs room in the file's queue before the flip is taken.
            if (len(self._events) + self._promised + 1) * abi.FLIP_COMPLETE.size > EVENT_SPACE:
                raise _fail(errno.ENOMEM)
            self._promised += 1
        # drm_mode_page_flip_ioctl: one flip at a time; it completes at the next vertical blank.
        crtc.pending = Flip(framebuffer, arg.user_data, self if wants_event else None)
        self._notify()

    def _fill(self, address: int, room: int, numbers: Sequence[int], kind: str = "I") -> int:
        """Copy as many numbers as there is room for; return how many there are."""
        fitting = numbers[:room]
        self._user.copy_to_user(address, struct.pack(f"<{len(fitting)}{kind}", *fitting))
        return len(numbers)


def _properties(connector: Connector | None) -> dict[int, int]:
    """Return property number → value of a connector."""
    if connector is None:
        return {}
    properties = {PROP_DPMS: connector.dpms}
    if connector.broadcast_rgb is not None:
        properties[PROP_BROADCAST_RGB] = connector.broadcast_rgb
    return properties


def _check_viewport(framebuffer: Framebuffer, mode: abi.Modeinfo, offset: tuple[int, int]) -> None:
    x, y = offset
    if x + mode.hdisplay > framebuffer.width or y + mode.vdisplay > framebuffer.height:
        raise _fail(errno.ENOSPC)


def _from(buffer: bytearray, kind: type[Struct]) -> Struct:
    """Return the argument of a call; bytes beyond the user's are zero, as in the kernel."""
    size = ctypes.sizeof(kind)
    return kind.from_buffer_copy(bytes(buffer[:size]).ljust(size, b"\0"))


def _into(buffer: bytearray, arg: ctypes.Structure) -> None:
    size = min(len(buffer), ctypes.sizeof(arg))
    buffer[:size] = bytes(arg)[:size]
