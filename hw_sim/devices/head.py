"""One output of the card: its modes, its framebuffer, and the flip that waits for the next vertical blank."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.devices import drm_abi as abi
from hw_sim.devices.drm_abi import Modeinfo

RGB_AUTOMATIC, RGB_FULL, RGB_LIMITED = 0, 1, 2
GAMMA_SIZE = 256
# CTA-861: codes 16..235 of 0..255.
LIMITED_RANGE = np.round(16 + np.arange(256) * 219 / 255).astype(np.uint8)


@dataclass(slots=True)
class Dumb:
    """A dumb buffer, shared with user space."""

    pitch: int
    memory: bytearray | memoryview
    offset: int = 0
    """Offset in the node at which user space maps it."""


@dataclass(frozen=True, slots=True)
class Framebuffer:
    """A dumb buffer as an image of 32-bit pixels, XRGB8888."""

    fb_id: int
    width: int
    height: int
    pitch: int
    depth: int
    dumb: Dumb

    def pixels(self) -> NDArray[np.uint8]:
        """Return a (height, width, 4) view: blue, green, red, unused."""
        rows = np.frombuffer(self.dumb.memory, np.uint8, self.pitch * self.height).reshape(self.height, self.pitch)
        return rows[:, : 4 * self.width].reshape(self.height, self.width, 4)


class FlipOwner(Protocol):
    """A file that opened the card and gets the events of its flips."""

    def deliver(self, user_data: int, time_ns: int, crtc: Crtc) -> None: ...

    def cut(self) -> None:
        """Note that the card is removed permanently: open files no longer work."""


@dataclass(frozen=True, slots=True)
class Flip:
    """A requested page flip."""

    framebuffer: Framebuffer
    user_data: int
    owner: FlipOwner | None
    """The opened file that gets the event; ``None``: no event was requested."""
    asked_ns: int = field(default_factory=time.monotonic_ns)
    """Real time."""


class Output(Enum):
    """An output, named by its monitor."""

    PROJECTOR = "HDMI-A-1"
    DISPLAY = "DP-1"


MODES: dict[Output, tuple[Modeinfo, ...]] = {
    Output.PROJECTOR: (
        # VESA DMT timings; 800x480 is that of common 7 inch panels.
        abi.mode("1024x768", 65_000, (1024, 1048, 1184, 1344), (768, 771, 777, 806), abi.NHSYNC | abi.NVSYNC, True),
        abi.mode("800x600", 40_000, (800, 840, 968, 1056), (600, 601, 605, 628), abi.PHSYNC | abi.PVSYNC, False),
        abi.mode("640x480", 25_175, (640, 656, 752, 800), (480, 490, 492, 525), abi.NHSYNC | abi.NVSYNC, False),
    ),
    Output.DISPLAY: (
        abi.mode("800x480", 29_760, (800, 824, 896, 992), (480, 483, 493, 500), abi.NHSYNC | abi.PVSYNC, True),
        abi.mode("640x480", 25_175, (640, 656, 752, 800), (480, 490, 492, 525), abi.NHSYNC | abi.NVSYNC, False),
    ),
}

PROJECTOR_MODES = {
    (1024, 768): MODES[Output.PROJECTOR],
    # CEA-861, VIC 4, and the smaller one that a scaler takes as well.
    (1280, 720): (
        abi.mode("1280x720", 74_250, (1280, 1390, 1430, 1650), (720, 725, 730, 750), abi.PHSYNC | abi.PVSYNC, True),
        MODES[Output.PROJECTOR][2],
    ),
}
"""Modes of a projector, by the raster of its chip."""


@dataclass(slots=True)
class Connector:
    """A socket with a monitor."""

    output: Output
    connector_id: int
    encoder_id: int
    kind: int
    kind_number: int
    size_mm: tuple[int, int]
    crtc: Crtc | None = None
    dpms: int = abi.DPMS_ON
    broadcast_rgb: int | None = None
    """``None``: the connector has no such property."""


def linear_gamma() -> NDArray[np.uint16]:
    """Return the (3, 256) uint16 table of red, green and blue as the kernel makes it: entry i is i << 8."""
    return np.tile((np.arange(GAMMA_SIZE) << 8).astype(np.uint16), (3, 1))


@dataclass(slots=True)
class Crtc:
    """A scan-out engine."""

    crtc_id: int
    sequence: int
    """Vertical blanks since the machine was switched on."""
    mode: Modeinfo | None = None
    framebuffer: Framebuffer | None = None
    """``None`` with a mode set: the console, black."""
    offset: tuple[int, int] = (0, 0)
    pending: Flip | None = None
    copied: NDArray[np.uint8] | None = None
    """(h, w, 4): the last copy of the framebuffer; ``None``: the framebuffer itself is scanned out."""
    gamma: NDArray[np.uint16] = field(default_factory=linear_gamma)
    """(3, 256) red, green and blue, 16 bit; the cable carries the upper 8."""

    def colour(self, channel: int) -> NDArray[np.uint8]:
        """Return a (height, width) uint8 copy of one channel (0 red, 1 green, 2 blue) after the gamma table."""
        table = (self.gamma[channel] >> 8).astype(np.uint8)
        # OpenCV takes a tenth of the time of indexing, which matters at every vertical blank.
        return np.asarray(cv2.LUT(cv2.extractChannel(self.image(), 2 - channel), table), np.uint8)

    def image(self) -> NDArray[np.uint8]:
        """Return the scanned-out image (height, width, 4) uint8: a view of shared memory, a copy of it, or black."""
        if self.mode is None:
            return np.zeros((1, 1, 4), np.uint8)
        width, height = self.mode.hdisplay, self.mode.vdisplay
        if self.framebuffer is None:
            return np.zeros((height, width, 4), np.uint8)
        x, y = self.offset
        pixels = self.framebuffer.pixels() if self.copied is None else self.copied
        return pixels[y : y + height, x : x + width]


def same_timing(a: Modeinfo, b: Modeinfo) -> bool:
    """Return True if two modes drive the monitor alike; name and type do not matter."""
    ignored = {"name", "type", "vrefresh"}
    return all(getattr(a, name) == getattr(b, name) for name, *_ in Modeinfo._fields_ if name not in ignored)


def slower_mode(mode: Modeinfo, refresh_hz: float) -> Modeinfo:
    """Return the same lines at another rate than 60 Hz: another pixel clock, rounded to the kernel's kHz."""
    slower = copy_mode(mode)
    slower.clock = round(mode.clock * refresh_hz / 60.0)
    slower.vrefresh = round(mode.vrefresh * refresh_hz / 60.0)
    return slower


def copy_mode(mode: Modeinfo) -> Modeinfo:
    """Return a copy of a mode."""
    return Modeinfo.from_buffer_copy(ctypes.string_at(ctypes.addressof(mode), ctypes.sizeof(mode)))
