"""Differences between the buses of Aravis: identity, clock, link, block ids, and lost cameras.

Sources: USB3 Vision 1.0 and GenCP 1.1 (through ``drivers.camera``); GigE Vision 1.2, bootstrap registers, all
big-endian.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.api import CameraIdentity, Clock, ClockReading, DeviceError, DeviceGone, DeviceRefused
from drivers.aravis.device import AravisDevice
from drivers.aravis.library import USB_ASYNC, AravisError
from drivers.camera import u3v
from drivers.camera.bootstrap import parse_identification, parse_stream_needs, parse_technology
from drivers.camera.control import ControlRefused
from drivers.camera.features import Features, RegisterMemory

NETWORK_MBPS = 1000
"""Speed that two megapixels at 60 Hz need: 115 MB/s, just below the capacity of Gigabit Ethernet with large packets."""
_GV_STRINGS = {"vendor": (0x48, 32), "model": (0x68, 32), "version": (0x88, 32), "serial": (0xD8, 16)}
_GV_TICK_FREQUENCY_HZ, _GV_TIMESTAMP_CONTROL, _GV_TIMESTAMP = 0x93C, 0x944, 0x948
_GV_LATCH = 2
_GV_LAST_BLOCK = 0xFFFF
"""Block ids of GigE Vision 1.x have 16 bits and leave out 0."""
_HALF = 0x8000


class Bus(Protocol):
    """One camera's bus."""

    def identity(self, features: Features) -> CameraIdentity:
        """Return the camera's identity. Raises DeviceGone, DeviceRefused."""

    def slow_link(self, link_speed_mbps: int | None) -> str | None:
        """Return the fault of a link that is too slow; ``None``: no fault, or unknown."""

    def read_clock(self, clock: Clock) -> ClockReading | None:
        """Latch the clock of the frames' stamps once; ``None`` where it has no latch. Raises DeviceGone."""

    def check(self) -> None:
        """Raise DeviceGone if the camera is lost."""

    def block_id(self, frame_id: int) -> int | None:
        """Return the block id of a frame's number on the wire; ``None``: it is no frame.

        Call it once for each frame. Block ids grow by one with each frame.
        """

    def confirm(self, payload_size: int) -> None:
        """Check that a new stream runs, since Aravis does not report a refusal.

        Raises DeviceGone, DeviceRefused.
        """

    def prepare(self) -> str:
        """Choose how images travel, at opening, and return it in words; empty without a choice.

        Raises DeviceRefused.
        """


class UsbBus:
    """USB3 Vision."""

    def __init__(self, device: AravisDevice) -> None:
        self._device = device
        self._sirm_address: int | None = None

    def identity(self, features: Features) -> CameraIdentity:
        """Read the bootstrap registers."""
        device = self._device
        who = parse_identification(device.read(u3v.ABRM_GENCP_VERSION, u3v.ABRM_HEAD_SIZE))
        technology = parse_technology(device.read(who.sbrm_address, u3v.SBRM_SIZE))
        self._sirm_address = technology.sirm_address
        return CameraIdentity(who.vendor, who.model, who.serial, who.firmware, technology.link_speed_mbps)

    def slow_link(self, link_speed_mbps: int | None) -> str | None:
        """Return the fault of a link below SuperSpeed."""
        return _too_slow(link_speed_mbps, u3v.SUPERSPEED_MBPS, "SuperSpeed")

    def read_clock(self, clock: Clock) -> ClockReading | None:
        """Use the latch of GenCP."""
        device = self._device
        return _latch_clock(
            clock,
            lambda: device.write(u3v.ABRM_TIMESTAMP_LATCH, (1).to_bytes(4, "little")),
            lambda: int.from_bytes(device.read(u3v.ABRM_TIMESTAMP, 8), "little"),
        )

    def check(self) -> None:
        """Read a register that every camera has."""
        _require_answer(self._device)

    def block_id(self, frame_id: int) -> int | None:
        """Return the number itself: it has 64 bits and begins at 0 with each start."""
        return frame_id

    def confirm(self, payload_size: int) -> None:
        """Read back whether the camera has enabled the stream.

        Aravis 0.8.26 requests a payload in transfers that need not be multiples of the camera's alignment, and some
        cameras refuse others.
        """
        if self._sirm_address is None:
            return
        needs = parse_stream_needs(self._device.read(self._sirm_address, u3v.SIRM_REQUIREMENTS_SIZE))
        if not needs.enabled:
            raise DeviceRefused(
                self._device.name,
                f"cannot send images of {payload_size} bytes, no multiple of its {needs.alignment} bytes",
                'Choose another size of the image, or kind = "usb3vision"',
            )

    def prepare(self) -> str:
        """Let several images wait in the kernel at a time.

        With one transfer after the other, no image came any more after a damaged trailer.
        """
        self._device.aravis.call.arv_uv_device_set_usb_mode(self._device.handle, USB_ASYNC)
        return ""


class NetworkBus:
    """GigE Vision, and Aravis' built-in camera, which has the same bootstrap registers."""

    def __init__(self, device: AravisDevice) -> None:
        self._device = device
        self._real = device.listed.protocol == "GigEVision"
        self._last = 0
        self._turns = 0

    def identity(self, features: Features) -> CameraIdentity:
        """Read the bootstrap registers.

        The speed is that of the camera's features, in Mbit/s, if they have it.
        """
        strings = {name: _text(self._device, *place) for name, place in _GV_STRINGS.items()}
        serial = strings["serial"] or self._device.listed.serial
        speed = round(features.number("GevLinkSpeed")) if features.has("GevLinkSpeed") else None
        return CameraIdentity(strings["vendor"], strings["model"], serial, strings["version"], speed)

    def slow_link(self, link_speed_mbps: int | None) -> str | None:
        """Return the fault of a link below Gigabit Ethernet."""
        return _too_slow(link_speed_mbps, NETWORK_MBPS, "Gigabit Ethernet")

    def read_clock(self, clock: Clock) -> ClockReading | None:
        """Use the latch of the bootstrap registers, in ticks of the camera's frequency."""
        device = self._device
        ticks_hz = _big(device, _GV_TICK_FREQUENCY_HZ)
        if not ticks_hz:
            return None
        reading = _latch_clock(
            clock,
            lambda: device.write(_GV_TIMESTAMP_CONTROL, _GV_LATCH.to_bytes(4, "big")),
            lambda: _big(device, _GV_TIMESTAMP) * 1_000_000_000 // ticks_hz,
        )
        # A clock counts from power-on: zero means that it was not latched.
        return reading if reading is not None and reading.camera_time_ns else None

    def check(self) -> None:
        """Check that this process still controls the camera.

        Aravis polls the camera each second; one that does not answer for three seconds is lost.
        """
        device = self._device
        if self._real and not device.aravis.call.arv_gv_device_is_controller(device.handle):
            raise device.gone("no longer answers over the network")

    def block_id(self, frame_id: int) -> int | None:
        """Return the number without wrapping: its 16 bits wrap from 65535 to 1.

        Block 0 is a packet that tests the way.
        """
        if self._real and frame_id == 0:
            return None
        if self._last - frame_id > _HALF and self._last <= _GV_LAST_BLOCK:
            self._turns += 1
        self._last = frame_id
        return frame_id + self._turns * _GV_LAST_BLOCK

    def confirm(self, payload_size: int) -> None:
        """Return at once: packets have room for any size."""

    def prepare(self) -> str:
        """Choose the largest packets that pass the network.

        Raises DeviceRefused if another program controls the camera.
        """
        if not self._real:
            return ""
        device = self._device
        if not device.aravis.call.arv_gv_device_is_controller(device.handle):
            raise DeviceRefused(
                device.name, "another program controls the camera", "Stop it; after a crash, wait for three seconds"
            )
        aravis = device.aravis
        try:
            size = aravis.checked(lambda error: aravis.call.arv_gv_device_auto_packet_size(device.handle, error))
        except AravisError as error:
            raise device.failed("test of packet sizes", error) from error
        return f"packets of {size} bytes"


def bus_of(device: AravisDevice) -> Bus:
    """Return the bus of a device."""
    return UsbBus(device) if device.listed.protocol == "USB3Vision" else NetworkBus(device)


def _too_slow(speed_mbps: int | None, needed_mbps: int, name: str) -> str | None:
    if speed_mbps is None or speed_mbps >= needed_mbps:
        return None
    return f"the link runs at {speed_mbps} Mbit/s; {name} ({needed_mbps}) is needed"


def _latch_clock(clock: Clock, latch: Callable[[], None], value_ns: Callable[[], int]) -> ClockReading | None:
    """Return one reading, bracketed by the host's clock; ``None`` where the camera refuses to latch."""
    try:
        sent_ns = clock.now_ns()
        latch()
        received_ns = clock.now_ns()
        return ClockReading(value_ns(), sent_ns, received_ns)
    except ControlRefused:
        return None


def _require_answer(device: AravisDevice) -> None:
    try:
        device.read(u3v.ABRM_GENCP_VERSION, 4)
    except DeviceGone:
        raise
    except DeviceError:
        return  # it answers, if only that it is busy


def _big(memory: RegisterMemory, address: int) -> int:
    return int.from_bytes(memory.read(address, 8), "big")


def _text(memory: RegisterMemory, address: int, size: int) -> str:
    return memory.read(address, size).split(b"\0", 1)[0].decode("utf-8", errors="replace").strip()
