"""Owns the displays of one graphics card for as long as the safe screen is shown: a page on one, black on the others.

The kernel's mode-setting calls by hand; their bytes are those of ``drivers.output.drm``, which needs no library either.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Any, Protocol

from drivers.output import drm
from kingfisher_safe.page import Picture

Page = Callable[[int, int], Picture]
"""Draws the page for a size in px."""
MOST = 64
"""Of CRTCs, connectors, encoders, modes: more than any card has."""


class Node(Protocol):
    """An opened card, as ``drivers.api.CardNode``."""

    def ioctl(self, request: int, buffer: bytearray) -> None:
        """Raises OSError."""

    def map(self, length: int, offset: int) -> memoryview:
        """Raises OSError."""

    def close(self) -> None:
        """Give it back."""


class KernelNode:
    """A card of this machine. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)

    def ioctl(self, request: int, buffer: bytearray) -> None:
        fcntl.ioctl(self._descriptor, request, buffer, True)

    def map(self, length: int, offset: int) -> memoryview:
        both = mmap.PROT_READ | mmap.PROT_WRITE
        return memoryview(mmap.mmap(self._descriptor, length, mmap.MAP_SHARED, both, offset=offset))

    def close(self) -> None:
        os.close(self._descriptor)


@dataclass(frozen=True, slots=True)
class _Socket:
    """A connector with something plugged in."""

    id: int
    name: str
    mode: drm.Mode
    crtcs: tuple[int, ...]


class Panel:
    """The card's displays. ``close`` gives them back to the kernel's console."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lit: dict[str, tuple[drm.Mode, memoryview, int, int]] = {}
        """By connector: mode, buffer, bytes from row to row, frame buffer."""
        self._used: set[int] = set()

    def show(self, page: Page, display: str | None, projector: str | None) -> tuple[str, ...]:
        """The page on ``display`` or, where that is not known or not there, on all but ``projector``, which gets black;
        returns the connectors that show it. Displays that were plugged in meanwhile are lit, too. Raises OSError where
        the card cannot be used at all.
        """
        sockets = self._sockets()
        for name in set(self._lit) - {socket.name for socket in sockets}:
            del self._lit[name]  # its buffer stays until the card is closed
        chosen = [socket.name for socket in sockets if socket.name == display]
        chosen = chosen or [socket.name for socket in sockets if socket.name != projector]
        for socket in sorted(sockets, key=lambda socket: socket.name not in chosen):  # the page first
            if socket.name not in self._lit:
                with contextlib.suppress(OSError):  # one head less
                    self._light(socket)
        shown = []
        for name, (mode, memory, pitch, framebuffer) in self._lit.items():
            if name in chosen:
                _copy(page(mode.width_px, mode.height_px), memory, pitch)
                # Cards that scan out a copy (virtual, USB, simple ones) make it anew when they are told; others know no such call.
                with contextlib.suppress(OSError):
                    self._call(drm.IOCTL_DIRTY_FRAMEBUFFER, drm.DIRTY_FRAMEBUFFER, framebuffer, 0, 0, 0, 0)
                shown.append(name)
        return tuple(shown)

    def close(self) -> None:
        self._node.close()

    def _light(self, socket: _Socket) -> None:
        crtc = next((crtc for crtc in socket.crtcs if crtc not in self._used), None)
        if crtc is None:
            raise OSError(f"no CRTC is left for {socket.name}")
        mode = socket.mode
        *_, handle, pitch, size = self._call(
            drm.IOCTL_CREATE_DUMB, drm.CREATE_DUMB, mode.height_px, mode.width_px, 32, 0, 0, 0, 0
        )
        framebuffer = self._call(
            drm.IOCTL_ADD_FRAMEBUFFER, drm.ADD_FRAMEBUFFER, 0, mode.width_px, mode.height_px, pitch, 32, 24, handle
        )[0]
        offset = self._call(drm.IOCTL_MAP_DUMB, drm.MAP_DUMB, handle, 0, 0)[2]
        memory = self._node.map(size, offset)
        _copy(Picture(mode.width_px, mode.height_px), memory, pitch)
        ids = array("I", [socket.id])
        self._call(drm.IOCTL_SET_CRTC, drm.CRTC, _address(ids), 1, crtc, framebuffer, 0, 0, 0, 1, mode.raw)
        self._used.add(crtc)
        self._lit[socket.name] = (mode, memory, pitch, framebuffer)

    def _sockets(self) -> list[_Socket]:
        """Connectors with something plugged in that offers a mode."""
        lists = [array("I", [0] * MOST) for _ in range(3)]
        crtcs, connectors, _encoders = lists
        counts = self._call(
            drm.IOCTL_GET_RESOURCES, drm.CARD_RESOURCES,
            0, *(_address(each) for each in lists), 0, MOST, MOST, MOST, 0, 0, 0, 0,
        )[4:8]  # fmt: skip
        found = [self._socket(connector, crtcs[: counts[1]]) for connector in connectors[: counts[2]]]
        return [socket for socket in found if socket is not None]

    def _socket(self, connector: int, crtcs: Sequence[int]) -> _Socket | None:
        modes = array("B", bytes(drm.MODE_INFO.size * MOST))
        encoders = array("I", [0] * MOST)
        got = self._call(
            drm.IOCTL_GET_CONNECTOR, drm.GET_CONNECTOR,
            _address(encoders), _address(modes), 0, 0, MOST, 0, MOST, 0, connector, *[0] * 7,
        )  # fmt: skip
        n_modes, n_encoders = min(got[4], MOST), min(got[6], MOST)
        if got[11] != drm.CONNECTED or not n_modes:
            return None
        size = drm.MODE_INFO.size
        offered = [drm.Mode.unpack(bytes(modes[k * size : (k + 1) * size])) for k in range(n_modes)]
        mask = 0
        for encoder in encoders[:n_encoders]:
            mask |= self._call(drm.IOCTL_GET_ENCODER, drm.GET_ENCODER, encoder, 0, 0, 0, 0)[3]
        possible = tuple(crtc for bit, crtc in enumerate(crtcs) if mask >> bit & 1)
        mode = next((mode for mode in offered if mode.preferred), offered[0])
        return _Socket(connector, drm.connector_name(got[9], got[10]), mode, possible)

    def _call(self, request: int, layout: Struct, *values: Any) -> tuple[Any, ...]:
        buffer = bytearray(layout.pack(*values))
        self._node.ioctl(request, buffer)
        return layout.unpack(buffer)


class Console:
    """The kernel's plain framebuffer, where the card itself is not to be had: ``/dev/fb0``, 32 bits a pixel."""

    def __init__(self, device: Path = Path("/dev/fb0"), facts: Path = Path("/sys/class/graphics/fb0")) -> None:
        """Raises OSError where there is none, or one of another kind."""

        def fact(name: str) -> str:
            return (facts / name).read_text(encoding="ascii").strip()

        try:
            width, height = (int(text) for text in fact("virtual_size").split(","))
            bits, self._pitch = int(fact("bits_per_pixel")), int(fact("stride"))
        except ValueError as error:
            raise OSError(f"{facts}: {error}") from error
        if bits != 32:
            raise OSError(f"{device} has {bits} bits a pixel; 32 are needed")
        self._size = width, height
        self._file = device.open("r+b", buffering=0)

    def show(self, page: Page) -> None:
        """Raises OSError."""
        for y, row in enumerate(page(*self._size).rows):
            self._file.seek(y * self._pitch)
            self._file.write(row)

    def close(self) -> None:
        self._file.close()


def _address(values: array[int]) -> int:
    """For the kernel to read or fill; no ctypes, which wants memory that is executable."""
    return values.buffer_info()[0]


def _copy(picture: Picture, memory: memoryview, pitch: int) -> None:
    flat = memory.cast("B")
    for y, row in enumerate(picture.rows):
        flat[y * pitch : y * pitch + len(row)] = row
