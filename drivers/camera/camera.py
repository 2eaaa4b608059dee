"""One USB3 Vision camera from opening to closing: identity, settings and stream."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any, Self

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
from drivers.camera import u3v
from drivers.camera.bootstrap import read_identification, read_stream_needs, read_technology
from drivers.camera.control import ControlChannel, ControlCounters, ControlRefused
from drivers.camera.description import read_description
from drivers.camera.features import Features
from drivers.camera.pixels import FORMATS
from drivers.camera.setup import CameraSetup
from drivers.camera.stream import StreamCounters, StreamGeometry, StreamReader
from drivers.camera.transfers import transfers_of
from drivers.camera.usb import UsbCamera, default_backend, find_camera

CLOCK_READINGS = 4
"""Number of readings: a host that is interrupted during one is not during all."""


class UsbVisionCamera:
    """A ``drivers.api.Camera`` behind USB3 Vision.

    Open it with ``open`` and close it, or use it in ``with``. Settings and start/stop may come from any thread;
    ``next_frame`` from one. ``start`` waits for a ``next_frame`` that is under way.
    """

    def __init__(
        self, spec: CameraSpec, usb: UsbCamera, control: ControlChannel, clock: Clock, host_speed_mbps: int | None
    ) -> None:
        """Read the camera's identity and load its description; ``open`` is the usual entry."""
        self._spec = spec
        self._usb = usb
        self._control = control
        self._clock = clock
        self._lock = threading.RLock()
        self._reading = threading.Lock()
        self._reader: StreamReader | None = None
        self._settings: CameraSettings | None = None

        identification = read_identification(control)
        technology = read_technology(control, identification.sbrm_address)
        if technology.stream_count < 1:
            raise DeviceRefused(spec.name, "the camera has no image stream", "Use a USB3 Vision camera")
        control.set_limits(technology.max_command_size, technology.max_answer_size, identification.max_response_time_s)
        self._sirm = technology.sirm_address
        self._features = Features(
            spec.name, read_description(control, spec.name, identification.manifest_address), control
        )
        if spec.pixel_format not in FORMATS:
            raise DeviceRefused(
                spec.name, f"pixel_format {spec.pixel_format!r} is none of {', '.join(FORMATS)}", "Correct the rig file"
            )
        self._format = FORMATS[spec.pixel_format]
        self._setup = CameraSetup(spec, self._features)
        self._in_pieces = False
        speed = host_speed_mbps if host_speed_mbps is not None else technology.link_speed_mbps
        self._identity = CameraIdentity(
            identification.vendor, identification.model, identification.serial, identification.firmware, speed
        )

    @classmethod
    def open(cls, spec: CameraSpec, backend: Any, clock: Clock) -> Self:
        """Find the camera by its serial number and open it; ``backend`` ``None`` means libusb-1.0.

        A camera that was left streaming by a crashed program is stopped. Raises DeviceGone (not there),
        DeviceRefused (no permission, in use, not a usable camera).
        """
        candidate = find_camera(default_backend() if backend is None else backend, spec.name, spec.serial)
        usb = UsbCamera(spec.name, candidate)
        try:
            camera = cls(spec, usb, ControlChannel(spec.name, usb.control(), clock), clock, candidate.link_speed_mbps)
            camera.stop()
        except ValueError as error:
            usb.close()
            raise DeviceRefused(
                spec.name, f"its registers contradict each other ({error})", "Update its firmware"
            ) from error
        except BaseException:
            usb.close()
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
            if self._reader is not None:
                try:
                    self._halt()
                except DeviceError:
                    self._reader = None
            with self._reading:
                self._usb.close()

    @property
    def identity(self) -> CameraIdentity:
        return self._identity

    @property
    def link_is_fast(self) -> bool | None:
        """True at SuperSpeed or better, False when the link fell back, ``None`` if unknown."""
        speed = self._identity.link_speed_mbps
        return None if speed is None else speed >= u3v.SUPERSPEED_MBPS

    @property
    def slow_link(self) -> str | None:
        """The fault of a link below SuperSpeed, like ``Camera.slow_link``."""
        if self.link_is_fast is not False:
            return None
        return f"the link runs at {self._identity.link_speed_mbps} Mbit/s; SuperSpeed (5000) is needed"

    @property
    def control_counters(self) -> ControlCounters:
        """Errors that the control channel repaired."""
        return self._control.counters

    @property
    def stream_counters(self) -> StreamCounters:
        """Events of the stream since ``start``; zeros when it does not run."""
        reader = self._reader
        return StreamCounters() if reader is None else reader.counters

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply ``settings`` and return those that the camera really has; a running stream is restarted.

        The first time all settings of an image are made (``drivers.camera.setup``); later only those that differ:
        exposure and gain, or all again for another size. Raises DeviceRefused, DeviceGone.
        """
        with self._lock:
            was_running = self._reader is not None
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
        """Flush stale buffers, start the stream, wait for triggers.

        May be called again at any time: queued frames are flushed and block ids begin anew. Raises DeviceRefused (not
        configured, stream refused), DeviceGone.
        """
        with self._lock, self._reading:
            settings = self._settings
            if settings is None:
                raise DeviceRefused(self._spec.name, "started before it was configured", "Call configure first")
            self._halt()
            reader = self._prepare_stream(settings)
            self._set_optional_number("TLParamsLocked", 1)
            self._control.write_u32(self._sirm + u3v.SIRM_CONTROL, u3v.SIRM_ENABLE)
            # From now on no frame is flushed, but one that was exposed earlier does not belong to this acquisition.
            reader.expect_since(self._now_ns())
            self._reader = reader
            self._features.execute("AcquisitionStart")

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> Frame:
        """Fill ``slot`` (height, width) uint8, C-contiguous, in place and without a copy.

        A bad frame is a status. Raises DeviceRefused when the stream does not run, DeviceGone when the camera is
        lost, ValueError for an unusable slot.
        """
        with self._reading:
            reader = self._reader
            if reader is None:
                raise DeviceRefused(self._spec.name, "asked for a frame while stopped", "Call start first")
            return reader.next_frame(slot, timeout_s)

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

        ``None`` where the camera has no time stamp to latch, which GenCP allows. Raises DeviceGone.
        """
        with self._lock:
            try:
                return min(
                    (self._read_clock_once() for _ in range(CLOCK_READINGS)), key=lambda reading: reading.bracket_ns
                )
            except ControlRefused:
                return None

    def _now_ns(self) -> int | None:
        """Return the time by the clock of the frames' stamps; ``None`` where none can be latched."""
        try:
            return self._read_clock_once().camera_time_ns
        except ControlRefused:
            return None

    def _read_clock_once(self) -> ClockReading:
        sent_ns = self._clock.now_ns()
        self._control.write_u32(u3v.ABRM_TIMESTAMP_LATCH, 1)
        received_ns = self._clock.now_ns()
        return ClockReading(self._control.read_u64(u3v.ABRM_TIMESTAMP), sent_ns, received_ns)

    def health(self) -> Health:
        """Return the camera's entry in ``kingfisher check``. A lost camera is reported, not raised."""
        identity = self._identity
        details = {
            "model": f"{identity.vendor} {identity.model}",
            "serial": identity.serial,
            "firmware": identity.firmware,
            "link": "unknown" if identity.link_speed_mbps is None else f"{identity.link_speed_mbps} Mbit/s",
        }
        try:
            temperature = self.temperature_c()
        except DeviceGone as error:
            return Health(self._spec.name, False, error.message, details)
        details["temperature"] = "unknown" if temperature is None else f"{temperature:.1f} °C"
        if self._setup.notes:
            details["not offered"] = ", ".join(self._setup.notes)
        if self._in_pieces:
            details["transfers"] = "images come in pieces of 1 MiB: whole ones failed"
        details["control retries"] = str(self._control.counters.retries)
        if self.link_is_fast is False:
            return Health(
                self._spec.name,
                False,
                f"link slow: {details['link']}; 5000 are needed. Check connector and cable",
                details,
            )
        if self._setup.bends_grey:
            bent = f"{' and '.join(self._setup.bends_grey)}: grey values are not proportional to light. Take that out of features"
            return Health(self._spec.name, False, bent, details)
        return Health(self._spec.name, True, details["model"], details)

    # ----------------------------------------------------------------------------------------------- settings

    def _set_optional_number(self, feature: str, value: float) -> None:
        if self._features.has(feature) and self._features.writable(feature):
            self._features.set_number(feature, value)

    # ------------------------------------------------------------------------------------------------- stream

    def _prepare_stream(self, settings: CameraSettings) -> StreamReader:
        """Set the transfer sizes of a disabled stream: the image in ONE transfer, straight into the slot.

        Where that failed before, in pieces of 1 MiB, as most programs read: not every camera and host takes larger
        transfers.
        """
        needs = read_stream_needs(self._control, self._sirm)
        pixels = settings.width_px * settings.height_px
        payload_size = self._format.payload_size(pixels)
        if payload_size is None:
            raise DeviceRefused(
                self._spec.name,
                f"{pixels} pixels cannot be packed as {self._format.name}",
                "Choose Mono8, or another size",
            )
        if needs.payload_size != payload_size:
            raise DeviceRefused(
                self._spec.name,
                f"sends {needs.payload_size} bytes for an image of {payload_size}",
                "Switch off chunk data and padding in the camera",
            )
        # Just after plugging in, some cameras report sizes of 0; one packet is enough for each.
        leader_size = _whole(needs.leader_size or u3v.SUPERSPEED_PACKET, needs.alignment)
        trailer_size = _whole(needs.trailer_size or u3v.SUPERSPEED_PACKET, needs.alignment)
        largest = max(leader_size, trailer_size, u3v.LEADER_SIZE)
        transfers = transfers_of(payload_size, needs.alignment, u3v.PIECE if self._in_pieces else None)
        geometry = StreamGeometry(
            width_px=settings.width_px,
            height_px=settings.height_px,
            format=self._format,
            payload_size=payload_size,
            transfers=transfers.sizes,
            packet_buffer_size=_whole(largest, u3v.SUPERSPEED_PACKET),
        )
        pipe = self._usb.stream()
        reader = StreamReader(self._spec.name, pipe, geometry, self._clock)
        reader.flush()
        for register, value in (
            (u3v.SIRM_MAX_LEADER_SIZE, leader_size),
            (u3v.SIRM_MAX_TRAILER_SIZE, trailer_size),
            (u3v.SIRM_PAYLOAD_TRANSFER_SIZE, transfers.size),
            (u3v.SIRM_PAYLOAD_TRANSFER_COUNT, transfers.count),
            (u3v.SIRM_FINAL_TRANSFER1_SIZE, transfers.final_1),
            (u3v.SIRM_FINAL_TRANSFER2_SIZE, transfers.final_2),
        ):
            self._control.write_u32(self._sirm + register, value)
        reader.reset_endpoint()
        return reader

    def _halt(self) -> None:
        """Stop the acquisition and disable the stream, in any state of the camera."""
        reader, self._reader = self._reader, None
        if reader is not None and reader.whole_transfers_fail:
            self._in_pieces = True
        if self._features.writable("AcquisitionStop"):
            self._features.execute("AcquisitionStop")
        self._control.write_u32(self._sirm + u3v.SIRM_CONTROL, 0)
        self._set_optional_number("TLParamsLocked", 0)


def _whole(size: int, unit: int) -> int:
    return -(-size // unit) * unit
