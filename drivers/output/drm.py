"""The bytes of the kernel's mode-setting interface: request numbers, structure layouts, names.

Source: the Linux user-space headers ``drm.h`` and ``drm_mode.h``. All fields are little endian and laid out without
implicit padding; pointers travel as 64-bit addresses of this process.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct

# ------------------------------------------------------------------------------- structures

MODE_INFO = Struct("<I10HIII32s")
"""clock_khz; hdisplay, hsync_start, hsync_end, htotal, hskew, vdisplay, vsync_start, vsync_end, vtotal, vscan;
vrefresh, flags, type, name."""
GET_CAP = Struct("<QQ")
"""capability, value."""
CARD_RESOURCES = Struct("<4Q8I")
"""Pointers to frame buffer, CRTC, connector and encoder ids; their counts; min/max width, min/max height."""
CRTC = Struct("<Q7I68s")
"""connectors pointer; count, crtc, frame buffer, x, y, gamma_size, mode_valid; mode."""
CRTC_LUT = Struct("<2I3Q")
"""crtc, size; pointers to red, green, blue (u16 each)."""
GET_ENCODER = Struct("<5I")
"""encoder, type, crtc, possible_crtcs (bit = index in the resources' list), possible_clones."""
GET_CONNECTOR = Struct("<4Q12I")
"""Pointers to encoders, modes, property ids, property values; counts of modes, properties, encoders; encoder,
connector, type, type number, connection, mm wide, mm high, subpixel, pad."""
GET_PROPERTY = Struct("<2Q2I32s2I")
"""values pointer, enum pointer; property, flags, name; counts of values and enum entries."""
PROPERTY_ENUM = Struct("<Q32s")
"""value, name."""
SET_PROPERTY = Struct("<Q2I")
"""value, property, connector."""
ADD_FRAMEBUFFER = Struct("<7I")
"""frame buffer (returned), width, height, pitch, bits per pixel, depth, handle."""
ID = Struct("<I")
"""A bare id or handle (RMFB, DESTROY_DUMB)."""
PAGE_FLIP = Struct("<4IQ")
"""crtc, frame buffer, flags, reserved, user data."""
DIRTY_FRAMEBUFFER = Struct("<4IQ")
"""frame buffer, flags, colour, count of clip rectangles (0: all of it), pointer to them."""
CREATE_DUMB = Struct("<6IQ")
"""height, width, bits per pixel, flags; returned: handle, pitch, size."""
MAP_DUMB = Struct("<2IQ")
"""handle, pad; returned: offset for mmap."""
EVENT_HEADER = Struct("<2I")
"""type, length including this header."""
FLIP_EVENT = Struct("<2IQ4I")
"""type, length; user data, seconds, microseconds, sequence, crtc (0 on kernels before 4.12)."""


def iowr(number: int, layout: Struct) -> int:
    """Return the number of a DRM ioctl that reads and writes ``layout``: ``_IOWR('d', number, size)``."""
    return 3 << 30 | layout.size << 16 | ord("d") << 8 | number


IOCTL_GET_CAP = iowr(0x0C, GET_CAP)
IOCTL_GET_RESOURCES = iowr(0xA0, CARD_RESOURCES)
IOCTL_GET_CRTC = iowr(0xA1, CRTC)
IOCTL_SET_CRTC = iowr(0xA2, CRTC)
IOCTL_SET_GAMMA = iowr(0xA5, CRTC_LUT)
IOCTL_GET_ENCODER = iowr(0xA6, GET_ENCODER)
IOCTL_GET_CONNECTOR = iowr(0xA7, GET_CONNECTOR)
IOCTL_GET_PROPERTY = iowr(0xAA, GET_PROPERTY)
IOCTL_SET_PROPERTY = iowr(0xAB, SET_PROPERTY)
IOCTL_ADD_FRAMEBUFFER = iowr(0xAE, ADD_FRAMEBUFFER)
IOCTL_REMOVE_FRAMEBUFFER = iowr(0xAF, ID)
IOCTL_PAGE_FLIP = iowr(0xB0, PAGE_FLIP)
IOCTL_DIRTY_FRAMEBUFFER = iowr(0xB1, DIRTY_FRAMEBUFFER)
IOCTL_CREATE_DUMB = iowr(0xB2, CREATE_DUMB)
IOCTL_MAP_DUMB = iowr(0xB3, MAP_DUMB)
IOCTL_DESTROY_DUMB = iowr(0xB4, ID)

CAP_DUMB_BUFFER = 0x1
CAP_TIMESTAMP_MONOTONIC = 0x6
PAGE_FLIP_EVENT = 0x01
EVENT_FLIP_COMPLETE = 0x02
CONNECTED = 1
PROPERTY_IS_ENUM = 1 << 3
MODE_PREFERRED = 1 << 3
MODE_INTERLACED_OR_DOUBLED = 1 << 4 | 1 << 5

CONNECTOR_TYPES = (
    "Unknown", "VGA", "DVI-I", "DVI-D", "DVI-A", "Composite", "SVIDEO", "LVDS", "Component", "DIN", "DP",
    "HDMI-A", "HDMI-B", "TV", "eDP", "Virtual", "DSI", "DPI", "Writeback", "SPI", "USB",
)  # fmt: skip
"""The kernel's names by type number; with the type's own count they make ``HDMI-A-1`` as in /sys/class/drm."""


def connector_name(type_number: int, type_count: int) -> str:
    """Return the connector's name: ``(11, 1)`` → ``HDMI-A-1``.

    A type that is not in this table reads ``Unknown``, as in the kernel.
    """
    is_known = type_number < len(CONNECTOR_TYPES)
    return f"{CONNECTOR_TYPES[type_number] if is_known else CONNECTOR_TYPES[0]}-{type_count}"


@dataclass(frozen=True, slots=True)
class Mode:
    """A display mode; ``raw`` has the kernel's bytes, which are handed back unchanged."""

    width_px: int
    height_px: int
    refresh_hz: float
    preferred: bool
    progressive: bool
    raw: bytes

    @classmethod
    def unpack(cls, raw: bytes) -> Mode:
        """Unpack a mode. Raises struct.error unless ``raw`` has 68 bytes."""
        clock_khz, width, _, _, htotal, _, height, _, _, vtotal, _, vrefresh, flags, kind, _ = MODE_INFO.unpack(raw)
        # vrefresh is rounded to whole Hz; the timing itself is exact. A driver may leave the timing empty.
        timed = clock_khz and htotal and vtotal
        refresh_hz = 1000.0 * clock_khz / (htotal * vtotal) if timed else float(vrefresh)
        return cls(width, height, refresh_hz, bool(kind & MODE_PREFERRED), not flags & MODE_INTERLACED_OR_DOUBLED, raw)

    def __str__(self) -> str:
        return f"{self.width_px}×{self.height_px} {self.refresh_hz:.2f} Hz{'' if self.progressive else ' interlaced'}"


@dataclass(frozen=True, slots=True)
class FlipDone:
    """The kernel's report that a flip became visible."""

    token: int
    time_ns: int
    raw_sequence: int


def parse_events(data: bytes) -> list[FlipDone]:
    """Return all flip reports of one read, oldest first; other events are skipped by their length.

    Raises ValueError on an impossible length: the stream is then out of step.
    """
    flips, position = [], 0
    while position < len(data):
        if len(data) - position < EVENT_HEADER.size:
            raise ValueError(f"DRM event of {len(data) - position} bytes; a header has {EVENT_HEADER.size}")
        kind, length = EVENT_HEADER.unpack_from(data, position)
        if not EVENT_HEADER.size <= length <= len(data) - position:
            raise ValueError(f"DRM event says {length} bytes; {len(data) - position} are there")
        if kind == EVENT_FLIP_COMPLETE and length >= FLIP_EVENT.size:
            _, _, token, seconds, microseconds, sequence, _ = FLIP_EVENT.unpack_from(data, position)
            flips.append(FlipDone(token, seconds * 1_000_000_000 + microseconds * 1_000, sequence))
        position += length
    return flips
