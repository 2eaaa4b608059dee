"""The contract between devices and the product above them: protocols and values, no behaviour.

Concrete drivers live beside this file; the rest of the product sees only these names. Units are in the names; ``None``
means missing. Every blocking call has a timeout. See ``docs/protocols``.
"""

from __future__ import annotations

import datetime
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CardGone as CardGone
from drivers.errors import DeviceError as DeviceError
from drivers.errors import DeviceGone as DeviceGone
from drivers.errors import DeviceRefused as DeviceRefused

# --------------------------------------------------------------------------------------------- time


class Clock(Protocol):
    """Monotonic time and waiting; the only source of both above the drivers."""

    def now_ns(self) -> int:
        """Monotonic time in ns, the same clock as flip and arrival time stamps."""

    def sleep_s(self, duration_s: float) -> None:
        """Return after ``duration_s`` of this clock."""

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Wait with ``condition`` held until ``predicate()`` or the timeout; return the predicate's value."""


class Date(Protocol):
    """A date of the calendar, and whether it is reliable."""

    @property
    def utc(self) -> datetime.datetime: ...

    @property
    def kept(self) -> bool:
        """True if an external source (a time server) has set it since power-on and keeps it."""


class Calendar(Protocol):
    """The date. It may jump, either way, and be of 1970: no times, orders or names depend on it."""

    def today(self) -> Date:
        """Return the date. Never raises: an unreliable date is not ``kept``."""


# ------------------------------------------------------------------------------------------- camera


class FrameStatus(Enum):
    """Status of one frame that was transferred to the host."""

    COMPLETE = "complete"
    """Leader, full payload and trailer agree."""
    TRUNCATED = "truncated"
    """The payload or the trailer came short, or the trailer reports fewer valid bytes."""
    CORRUPT = "corrupt"
    """A leader or trailer without its magic, with a wrong size, pixel format or image size."""
    WRONG_ID = "wrong id"
    """The trailer's block id is not the leader's."""
    DISCARDED = "discarded"
    """The camera reports that it discarded data or overran (status A100, A101)."""
    TIMEOUT = "timeout"
    """No leader within the time allowed."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame as it arrived. The pixels are in the slot that was handed to ``next_frame``."""

    status: FrameStatus
    block_id: int | None
    camera_time_ns: int | None
    """Start of exposure in the camera's own clock."""
    received_ns: int
    """Arrival of the trailer (or of the failure) in host time."""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    vendor: str
    model: str
    serial: str
    firmware: str
    link_speed_mbps: int | None
    """Negotiated bus speed (5000 = SuperSpeed); ``None`` when the host does not know."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    width_px: int
    height_px: int
    exposure_us: float
    gain_db: float


@dataclass(frozen=True, slots=True)
class ClockReading:
    """A camera's own clock, read at an unknown moment between two times of the host's clock."""

    camera_time_ns: int
    host_sent_ns: int
    host_received_ns: int

    @property
    def offset_ns(self) -> int:
        """Host minus camera; its error is at most half of the bracket."""
        return (self.host_sent_ns + self.host_received_ns) // 2 - self.camera_time_ns

    @property
    def bracket_ns(self) -> int:
        """Time between request and answer."""
        return self.host_received_ns - self.host_sent_ns


FeatureValue = bool | float | str
"""Value of a camera's feature; of an enumeration its symbol."""


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """One camera of the rig.

    ``name`` is the rig's name for it (``camera.left``) and appears in every error. ``serial`` is the serial number
    the camera itself reports. ``trigger_source`` is the SFNC name of the input that the board's trigger line is
    wired to; ``None`` takes the first ``Line…`` the camera offers.
    """

    name: str
    serial: str
    trigger_source: str | None = None
    pixel_format: str = "Mono8"
    """The PFNC name of the camera's pixel format; more than 8 bits are reduced to the upper 8."""
    offset_x_px: int | None = None
    """First column on the sensor; ``None``: the image lies in its middle."""
    offset_y_px: int | None = None
    features: tuple[tuple[str, FeatureValue], ...] = ()
    """Features by their SFNC or maker's names, in order, that replace built-in settings or follow them; a leading
    ``?``: may be missing.
    """


@dataclass(frozen=True, slots=True)
class HeldSetting:
    """One setting as it was requested, and as the camera holds it."""

    feature: str
    requested: FeatureValue | None
    """Requested value; ``None``: the setting was only read."""
    held: FeatureValue | None
    """Value that was read back; ``None``: the camera has no such feature."""


@runtime_checkable
class ReadsBack(Protocol):
    """A camera whose settings can be read back. Not every family can."""

    def read_back(self) -> tuple[HeldSetting, ...]:
        """Return every setting that ``configure`` made, in its order, as the camera holds it now.

        Raises DeviceGone.
        """


class Camera(Protocol):
    """A hardware-triggered camera of any family (``drivers.camera_families``).

    One thread calls ``next_frame``; the core owns the memory.
    """

    @property
    def identity(self) -> CameraIdentity: ...

    @property
    def slow_link(self) -> str | None:
        """The fault of a link that is too slow for the images of a scan; ``None``: no fault, or unknown."""

    def health(self) -> Health:
        """Return the camera's entry in ``kingfisher check``. A lost camera is reported, not raised."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings, with trigger on and Mono8, and return those of the camera.

        Raises DeviceRefused, DeviceGone.
        """

    def start(self) -> None:
        """Flush stale buffers, start the stream, wait for triggers.

        A running stream is flushed and starts anew, with block ids from their beginning. Raises DeviceError.
        """

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> Frame:
        """Fill ``slot`` (height, width) uint8 in place.

        A bad frame is a status; a lost device raises DeviceGone.
        """

    def stop(self) -> None:
        """End acquisition. Idempotent. Raises DeviceGone."""

    def temperature_c(self) -> float | None:
        """Temperature of the camera, ``None`` where it has no sensor. Not while a frame is being read."""

    def read_clock(self) -> ClockReading | None:
        """Return the clock of the frames' time stamps; ``None`` where it cannot be read. Raises DeviceGone."""


# -------------------------------------------------------------------------------------------- board


@dataclass(frozen=True, slots=True)
class BoardTime:
    """The board's clock, read at an unknown moment between two times of the host's clock."""

    board_time_us: int
    host_sent_ns: int
    host_received_ns: int


@dataclass(frozen=True, slots=True)
class Vsync:
    """The latest vertical sync of the board, with the board's times and the host's times of the query."""

    count: int
    board_time_us: int
    board_now_us: int
    host_sent_ns: int
    host_received_ns: int


@dataclass(frozen=True, slots=True)
class Pulse:
    """One trigger pulse, as the board reports it."""

    index: int
    vsync: int
    board_time_us: int


@dataclass(frozen=True, slots=True)
class LaserState:
    """State of the lasers, read back from the drivers' current sense."""

    left_on: bool
    right_on: bool


@dataclass(frozen=True, slots=True)
class Telemetry:
    """One heartbeat. A sensor that is not fitted or does not answer is ``None``."""

    received_ns: int
    board_time_us: int
    vsync: int
    lasers: LaserState
    temperature_projector_c: float | None = None
    temperature_case_c: float | None = None
    temperature_board_c: float | None = None
    leak: bool | None = None
    humidity_percent: float | None = None
    supply_v: float | None = None


@dataclass(frozen=True, slots=True)
class BoardBooted:
    """The board was reset: it has lost all settings and commands."""

    firmware: str
    serial: str
    cause: str


@dataclass(frozen=True, slots=True)
class PulsesDone:
    count: int


@dataclass(frozen=True, slots=True)
class VsyncLost:
    pass


@dataclass(frozen=True, slots=True)
class BoardLost:
    """The port vanished or the board fell silent."""

    reason: str


BoardEvent = Pulse | PulsesDone | VsyncLost | Telemetry | BoardBooted | BoardLost


class Board(Protocol):
    """The trigger board. Commands may come from any thread, one at a time."""

    def vsync(self) -> Vsync: ...

    def arm(self, pulses: int, at_vsync: int, delay_us: int, width_us: int) -> None:
        """Fire ``pulses``, one per vertical sync from number ``at_vsync`` on.

        Raises DeviceRefused (busy, past, out of range), DeviceGone.
        """

    def live(self, every: int, delay_us: int, width_us: int) -> None: ...

    def stop(self) -> None: ...

    def set_lasers(self, left_on: bool, right_on: bool) -> LaserState:
        """Switch and return the read-back, which may differ; the caller decides about that."""

    def next_event(self, timeout_s: float) -> BoardEvent | None:
        """Return the oldest unread report; ``None`` after the timeout."""


# --------------------------------------------------------------------------------------------- keys


class Key(Enum):
    SCAN = "scan"
    """Scan, and OK in menus."""
    BACK = "back"
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True, slots=True)
class KeyPress:
    """A debounced press; ``time_ns`` is host time of the change."""

    key: Key
    time_ns: int


@dataclass(frozen=True, slots=True)
class KeyLongPress:
    """The key has been held for 0.8 s; comes after its KeyPress, once."""

    key: Key
    time_ns: int


@dataclass(frozen=True, slots=True)
class KeyRelease:
    key: Key
    time_ns: int
    held_s: float


@dataclass(frozen=True, slots=True)
class KeyStuck:
    """The key was held longer than 8 s or the pad reported it faulty; masked until it is seen released."""

    key: Key


@dataclass(frozen=True, slots=True)
class KeyFreed:
    """A stuck key was seen released; from now on it counts again."""

    key: Key


@dataclass(frozen=True, slots=True)
class KeysLost:
    reason: str


KeyEvent = KeyPress | KeyLongPress | KeyRelease | KeyStuck | KeyFreed | KeysLost


class Keys(Protocol):
    def next_event(self, timeout_s: float) -> KeyEvent | None:
        """Return the next event; ``None`` after the timeout.

        KeysLost comes once. After an unplugged pad's every further call raises DeviceGone; a pad that only fell silent
        may come back by itself.
        """


# ------------------------------------------------------------------------------------------- output


@dataclass(frozen=True, slots=True)
class Flip:
    """The kernel's report that a buffer is on the screen since ``time_ns``."""

    index: int
    """Index of the loaded frame (or -1 for a presented image)."""
    sequence: int | None
    """The display's vertical-blank counter; ``None`` where the hardware has none."""
    time_ns: int


class Projector(Protocol):
    """An output that plays frames loaded beforehand, one per vertical blank."""

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""

    def load(self, frames: Sequence[NDArray[np.uint8]]) -> None:
        """Copy frames, (height, width) uint8 of green light each, into scan-out buffers 0..n-1."""

    def show(self, index: int) -> Flip:
        """Flip to one frame and stay there."""

    def play(
        self,
        indices: Sequence[int],
        idle: int,
        start: Callable[[Flip], int | None],
        abort: Callable[[], bool],
    ) -> list[Flip]:
        """Flip through ``indices``, one per vertical blank, and end on ``idle``.

        First flips ``idle`` at every blank; ``start`` is called once with such a flip and returns the sequence
        number at which ``indices[0]`` must appear (at least two blanks ahead; ``None`` = as soon as possible). Where
        flips have no sequence number, it returns how many periods after that flip.
        Returns the flips of ``indices`` as they happened. A late flip is returned, not hidden, and ends the
        play early, as does ``abort()``, which is called at every blank. Raises DeviceGone.
        """


class Display(Protocol):
    """The diver's screen."""

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""

    def present(self, image: NDArray[np.uint8], timeout_s: float) -> Flip:
        """Show ``image`` (height, width, 3) RGB uint8 at the next vertical blank and wait for it.

        Raises DeviceGone.
        """


# -------------------------------------------------------------------------------------------- wires


class CardNode(Protocol):
    """An opened DRM node: exactly the system calls the scan-out code makes."""

    def ioctl(self, request: int, buffer: bytearray) -> None:
        """Do the same as ``fcntl.ioctl(fd, request, buffer, True)``. Raises OSError.

        Pointers are addresses of this process.
        """

    def map(self, length: int, offset: int) -> memoryview:
        """Map a dumb buffer like ``mmap``: writable, shared."""

    def read(self, size: int) -> bytes:
        """Read like ``os.read`` on a non-blocking descriptor. Raises BlockingIOError if there are no data."""

    def wait_readable(self, timeout_s: float) -> bool:
        """Wait like ``select``: True when an event can be read."""

    def close(self) -> None: ...


class Wires(Protocol):
    """See ``docs/protocols/wires.md``."""

    usb_backend: Any
    hidraw: Any

    @property
    def clock(self) -> Clock: ...

    @property
    def calendar(self) -> Calendar: ...

    def cards(self) -> Sequence[str]:
        """Return the paths of all graphics cards."""

    def open_card(self, path: str) -> CardNode: ...


WiresOptions = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Health:
    """A device's entry in ``kingfisher check``."""

    device: str
    ok: bool
    summary: str
    details: Mapping[str, str] = field(default_factory=dict)
