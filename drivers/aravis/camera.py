"""One camera behind Aravis from opening to closing: identity, settings and stream."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.api import (
    CameraIdentity,
    CameraSettings,
    CameraSpec,
    Clock,
    ClockReading,
    DeviceError,
    DeviceGone,
    DeviceRefused,
    Frame,
    Health,
    HeldSetting,
)
from drivers.aravis.buses import bus_of
from drivers.aravis.device import AravisDevice
from drivers.aravis.library import BUILT_IN, STUCK, Aravis, ListedCamera, library
from drivers.aravis.stream import AravisStream
from drivers.camera import u3v
from drivers.camera.features import Features
from drivers.camera.pixels import FORMATS
from drivers.camera.setup import CameraSetup

CLOCK_READINGS = 4
"""Number of readings: a host that is interrupted during one is not during all."""


class AravisCamera:
    """A ``drivers.api.Camera`` behind Aravis; open it with ``open`` and close it, or use it in ``with``.

    Settings and start/stop may come from any thread; ``next_frame`` from one. ``start`` waits for a ``next_frame`` that
    is under way.
    """

    def __init__(self, spec: CameraSpec, device: AravisDevice, clock: Clock) -> None:
        """Read the camera's identity and load its description; ``open`` is the usual entry."""
        self._spec = spec
        self._device = device
        self._clock = clock
        self._lock = threading.RLock()
        self._reading = threading.Lock()
        self._stream: AravisStream | None = None
        self._settings: CameraSettings | None = None
        if spec.pixel_format not in FORMATS:
            raise DeviceRefused(
                spec.name, f"pixel_format {spec.pixel_format!r} is none of {', '.join(FORMATS)}", "Correct the rig file"
            )
        self._format = FORMATS[spec.pixel_format]
        self._bus = bus_of(device)
        self._transport = self._bus.prepare()
        self._features = Features(spec.name, device.description(), device)
        self._setup = CameraSetup(spec, self._features)
        self._identity = self._bus.identity(self._features)

    @classmethod
    def open(cls, spec: CameraSpec, clock: Clock) -> Self:
        """Find the camera by its serial number on every interface of Aravis and open it.

        A camera that was left streaming by a crashed program is stopped. Raises DeviceGone (not there), DeviceRefused
        (no library, no permission, in use, not a usable camera).
        """
        device = find_device(spec.name, spec.serial, library(spec.name))
        try:
            camera = cls(spec, device, clock)
            camera.stop()
        except ValueError as error:
            device.close()
            raise DeviceRefused(
                spec.name, f"its registers contradict each other ({error})", "Update its firmware"
            ) from error
        except BaseException:
            device.close()
            raise
        return camera

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop and release the camera; idempotent, silent when it is gone."""
        with self._lock:
            if self._stream is not None:
                with suppress(DeviceError):
                    self._halt()
            with self._reading:
                self._device.close()

    @property
    def identity(self) -> CameraIdentity:
        return self._identity

    @property
    def slow_link(self) -> str | None:
        """The fault of the link, like ``Camera.slow_link``; each bus has its own limit."""
        return self._bus.slow_link(self._identity.link_speed_mbps)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply ``settings`` and return those that the camera really has; a running stream is restarted.

        The order is that of ``drivers.camera.setup``. Raises DeviceRefused, DeviceGone.
        """
        with self._lock:
            was_running = self._stream is not None
            if was_running:
                self._halt()
            before = self._settings
            if before is None:
                self._setup.load_defaults()
            if before is not None and (before.width_px, before.height_px) == (settings.width_px, settings.height_px):
                self._settings = self._setup.light(settings)
            else:
                self._settings = None
                self._settings = self._setup.apply(settings)
            if was_running:
                self.start()
            return self._settings

    def start(self) -> None:
        """Restart the stream with empty buffers, and wait for triggers.

        Raises DeviceRefused (not configured, stream refused), DeviceGone.
        """
        with self._lock:
            self._start()

    def _start(self) -> None:
        settings = self._settings
        if settings is None:
            raise DeviceRefused(self._spec.name, "started before it was configured", "Call configure first")
        self._end_waiting()
        with self._reading:
            self._halt_now()
            size_px = (settings.width_px, settings.height_px)
            payload_size = self._payload_size(settings.width_px * settings.height_px)
            stream = AravisStream(self._device, self._bus, self._clock, size_px, self._format, payload_size)
            self._stream = stream
            self._bus.confirm(payload_size)
            self._set_optional_number("TLParamsLocked", 1)
            now = self._bus.read_clock(self._clock)
            # From now on no frame is flushed, but one that was exposed earlier does not belong to this acquisition.
            stream.expect_since(None if now is None else now.camera_time_ns)
            self._features.execute("AcquisitionStart")

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> Frame:
        """Fill ``slot`` (height, width) uint8, C-contiguous, by one copy.

        A bad frame is a status. Raises DeviceRefused when the stream does not run, DeviceGone when the camera is lost,
        ValueError for an unusable slot.
        """
        with self._reading:
            stream = self._stream
            if stream is None:
                raise DeviceRefused(self._spec.name, "asked for a frame while stopped", "Call start first")
            return stream.next_frame(slot, timeout_s)

    def stop(self) -> None:
        """End acquisition. Idempotent. Raises DeviceGone, DeviceRefused."""
        with self._lock:
            self._halt()

    def read_back(self) -> tuple[HeldSetting, ...]:
        """Return the camera's settings, as ``ReadsBack`` does. Raises DeviceGone, DeviceRefused."""
        with self._lock:
            return self._setup.read_back()

    def temperature_c(self) -> float | None:
        """Temperature of the camera, ``None`` where it has no sensor. Raises DeviceGone."""
        with self._lock:
            if not self._features.has("DeviceTemperature"):
                return None
            try:
                return self._features.number("DeviceTemperature")
            except DeviceRefused:
                return None  # fitted, but not readable in this state: unknown, not zero

    def read_clock(self) -> ClockReading | None:
        """Return the clock of the frames' time stamps: the reading of several that took the host least time.

        ``None`` where the camera has no time stamp to latch. Raises DeviceGone.
        """
        with self._lock:
            readings = [self._bus.read_clock(self._clock) for _ in range(CLOCK_READINGS)]
            return min(
                (reading for reading in readings if reading is not None),
                key=lambda reading: reading.bracket_ns,
                default=None,
            )

    def health(self) -> Health:
        """Return the camera's entry in ``kingfisher check``. A lost camera is reported, not raised."""
        identity, listed = self._identity, self._device.listed
        details = {
            "model": f"{identity.vendor} {identity.model}",
            "serial": identity.serial,
            "firmware": identity.firmware,
            "link": "unknown" if identity.link_speed_mbps is None else f"{identity.link_speed_mbps} Mbit/s",
            "through": f"Aravis {self._device.aravis.version}, {listed.protocol} at {listed.address}",
        }
        try:
            self._bus.check()
            temperature = self.temperature_c()
        except DeviceGone as error:
            return Health(self._spec.name, False, error.message, details)
        details["temperature"] = "unknown" if temperature is None else f"{temperature:.1f} °C"
        if self._transport:
            details["transport"] = self._transport
        if self._setup.notes:
            details["not offered"] = ", ".join(self._setup.notes)
        if self.slow_link is not None:
            return Health(self._spec.name, False, f"link slow: {details['link']}. Check connector and cable", details)
        if self._setup.bends_grey:
            bent = f"{' and '.join(self._setup.bends_grey)}: grey values are not proportional to light. Take that out of features"
            return Health(self._spec.name, False, bent, details)
        return Health(self._spec.name, True, details["model"], details)

    # ------------------------------------------------------------------------------------------------- stream

    def _payload_size(self, pixels: int) -> int:
        """Return the bytes of an image. Raises DeviceRefused where the camera would send another number."""
        size = self._format.payload_size(pixels)
        if size is None:
            raise DeviceRefused(
                self._spec.name,
                f"{pixels} pixels cannot be packed as {self._format.name}",
                "Choose Mono8, or another size",
            )
        sent = round(self._features.number("PayloadSize")) if self._features.has("PayloadSize") else size
        if sent != size:
            raise DeviceRefused(
                self._spec.name,
                f"sends {sent} bytes for an image of {size}",
                "Switch off chunk data and padding in the camera",
            )
        return size

    def _set_optional_number(self, feature: str, value: float) -> None:
        if self._features.has(feature) and self._features.writable(feature):
            self._features.set_number(feature, value)

    def _halt(self) -> None:
        """Stop the acquisition after ``next_frame`` has returned."""
        self._end_waiting()
        with self._reading:
            self._halt_now()

    def _end_waiting(self) -> None:
        if self._stream is not None:
            self._stream.end()

    def _halt_now(self) -> None:
        """Stop the acquisition in any state; the stream is dropped even if the camera is lost."""
        try:
            if self._features.writable("AcquisitionStop"):
                self._features.execute("AcquisitionStop")
        finally:
            self._drop_stream()
        self._set_optional_number("TLParamsLocked", 0)

    def _drop_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()


def find_device(name: str, serial: str, aravis: Aravis) -> AravisDevice:
    """Open the camera with that serial number.

    Raises DeviceGone, which lists the others, or DeviceRefused.
    """
    if name in aravis.stuck:
        raise DeviceRefused(name, *STUCK)
    with aravis.finding:
        return _search(name, serial, aravis)


def _search(name: str, serial: str, aravis: Aravis) -> AravisDevice:
    other_serials: list[str] = []
    silent: list[str] = []
    for listed in aravis.cameras():
        device: AravisDevice | None = None
        try:
            if listed.protocol == "USB3Vision" and aravis.serial_of(listed.id) is None:
                device = AravisDevice(name, aravis, listed)
            own_serial = _own_serial(aravis, listed, device)
        except DeviceError as error:
            silent.append(f"{listed.id}: {error.message}")
            if device is not None:
                device.close()
            continue
        if serial in (own_serial, listed.id):
            return device or AravisDevice(name, aravis, listed)
        if device is not None:
            device.close()
        if listed.protocol != BUILT_IN:
            other_serials.append(own_serial)
    if silent:
        raise DeviceRefused(
            name,
            f"serial number {serial} not found, and the serial number of a camera cannot be read ({'; '.join(silent)})",
            "Install the udev rules, or stop the program that uses the camera",
        )
    presence = f"there are {', '.join(sorted(other_serials))}" if other_serials else "Aravis sees no camera"
    raise DeviceGone(name, f"serial number {serial} not found; {presence}", "Check the connector and the rig's serial")


def listed_cameras(aravis: Aravis) -> Iterator[str]:
    """Yield serial number, protocol and address of every camera but Aravis' built-in one.

    For a camera that cannot be read the reason stands in place of the number.
    """
    with aravis.finding:
        for listed in aravis.cameras():
            if listed.protocol == BUILT_IN:
                continue
            try:
                own_serial = _read_serial(aravis, listed)
            except DeviceError as error:
                own_serial = f"serial number not readable ({error.message})"
            protocol = {"USB3Vision": "USB3 Vision", "GigEVision": "GigE Vision"}.get(listed.protocol, listed.protocol)
            yield f"{own_serial or 'no serial number'} ({protocol}, {listed.address or listed.id})"


def _read_serial(aravis: Aravis, listed: ListedCamera) -> str:
    if listed.protocol != "USB3Vision" or aravis.serial_of(listed.id) is not None:
        return _own_serial(aravis, listed, None)
    with AravisDevice("cameras", aravis, listed) as device:
        return _own_serial(aravis, listed, device)


def _own_serial(aravis: Aravis, listed: ListedCamera, device: AravisDevice | None) -> str:
    """Return the serial number that a camera itself reports: over USB the library lists that of the bus."""
    if listed.protocol != "USB3Vision":
        return listed.serial
    if device is not None:
        registers = device.read(u3v.ABRM_SERIAL_NUMBER, u3v.ABRM_STRING_SIZE)
        aravis.remember(listed.id, registers.split(b"\0", 1)[0].decode("utf-8", errors="replace").strip())
    return aravis.serial_of(listed.id) or ""
