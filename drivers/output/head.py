"""One lit output: a connector, its mode, its CRTC, and its scan-out buffers."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator, Mapping

from drivers.api import CardGone, Clock, DeviceError, DeviceGone, DeviceRefused
from drivers.output import drm
from drivers.output.card import Buffer, Card, Connector
from drivers.output.pacing import BlankCounter, Pacer
from drivers.output.surface import FlipStamp

BUSY_TRIES = 20
BUSY_PAUSE_S = 0.001
CONNECTION_CHECK_EVERY_FLIPS = 60

WANTED_PROPERTIES = {
    "Broadcast RGB": "Full",
    "Colorspace": "Default",
    "dither": "off",
    "dithering mode": "off",
    "underscan": "off",
}
"""Values of connector properties with which a code reaches the screen as it was written, where a driver offers a
choice."""

_GONE = frozenset({errno.ENODEV, errno.ENXIO, errno.EIO, errno.EBADF})
_NOT_MASTER = frozenset({errno.EACCES, errno.EPERM})


@contextlib.contextmanager
def device_errors(device: str, doing: str) -> Iterator[None]:
    """Turn the kernel's errors into DeviceGone and DeviceRefused with the failed action and the remedy."""
    try:
        yield
    except OSError as error:
        message = f"{doing} failed ({error.strerror or error})"
        if error.errno in _GONE:
            raise CardGone(device, message, "The graphics card is gone; restart the instrument") from error
        if error.errno in _NOT_MASTER:
            raise DeviceRefused(
                device, message, "Another program owns the screens: stop the desktop or the other instance"
            ) from error
        raise DeviceRefused(device, message, "Check the kernel log for the graphics driver's reason") from error
    except ValueError as error:
        raise DeviceRefused(device, f"{doing} failed ({error})", "The graphics driver is broken; restart") from error


class Head:
    """A connector with a mode set, showing black from the start. Used by one thread at a time.

    Raises DeviceError when it cannot be lit; all buffers made until then are released.
    """

    def __init__(self, device: str, card: Card, connector: Connector, crtc: int, mode: drm.Mode, clock: Clock) -> None:
        self.device = device
        self.size_px = (mode.width_px, mode.height_px)
        self.refresh_hz = mode.refresh_hz
        self.mode = mode
        self.connector = connector
        self._card = card
        self._crtc = crtc
        self._clock = clock
        self._counter = BlankCounter()
        self._pacer = Pacer(clock, mode.refresh_hz)
        self._buffers: list[Buffer] = []
        self._pending: int | None = None
        self._flips = 0
        self.details: dict[str, str] = {}
        self._require_capabilities()
        black = self.create_picture()
        self._set_properties()
        try:
            with device_errors(device, f"setting {mode} on {connector.name}"):
                card.light(crtc, connector.id, mode, black)
        except DeviceError:
            self.close()
            raise
        self._linearise()

    @property
    def crtc(self) -> int:
        return self._crtc

    def create_picture(self) -> Buffer:
        """Make a black buffer of the mode's size; it is released with the head. Raises DeviceError."""
        with device_errors(self.device, f"allocating a scan-out buffer of {self.size_px[0]}×{self.size_px[1]} px"):
            buffer = self._card.create_buffer(*self.size_px)
        self._buffers.append(buffer)
        return buffer

    def flip(self, picture: Buffer, timeout_s: float) -> FlipStamp:
        """Show ``picture`` from the next vertical blank on and wait until it is visible.

        Raises DeviceGone when the report does not come within ``timeout_s``, when the cable was unplugged, or when the
        card is gone; DeviceRefused when the kernel stays busy.
        """
        self._flips += 1
        if self._flips % CONNECTION_CHECK_EVERY_FLIPS == 0:
            self.check_connection()
        self._pacer.wait()
        if self._pending is not None:  # a flip that timed out before: the kernel takes one at a time
            self._finish(self._pending, timeout_s)
        self._pending = self._submit(picture, timeout_s)
        return self._finish(self._pending, timeout_s)

    def check_connection(self) -> None:
        """Raise DeviceGone if the driver noticed that the cable is out."""
        with device_errors(self.device, f"asking {self.connector.name}"):
            connected = self._card.is_connected(self.connector.id)
        if not connected:
            raise DeviceGone(self.device, f"{self.connector.name} was unplugged", "Check its cable and its power")

    def describe(self) -> tuple[str, Mapping[str, str]]:
        pacing = {"flips": "not throttled by the hardware"} if self._pacer.unthrottled else {}
        return f"{self.connector.name} {self.mode}", {**self.details, **pacing}

    def close(self) -> None:
        """Darken the output and release its buffers. A card that is gone has already done so."""
        if self._pending is not None:
            self._card.forget_flip(self._pending)
            self._pending = None
        with contextlib.suppress(OSError):
            self._card.darken(self._crtc)
        for buffer in self._buffers:
            with contextlib.suppress(OSError):
                self._card.destroy_buffer(buffer)
        self._buffers.clear()

    # --------------------------------------------------------------------------------- flipping

    def _submit(self, picture: Buffer, timeout_s: float) -> int:
        for tries_left in reversed(range(BUSY_TRIES)):
            try:
                return self._card.submit_flip(self._crtc, picture)
            except OSError as error:
                # Drivers report a flip a moment before they accept the next one: pause, do not spin.
                if error.errno == errno.EBUSY and tries_left:
                    self._clock.sleep_s(BUSY_PAUSE_S)
                    continue
                if error.errno == errno.EBUSY:
                    raise DeviceRefused(
                        self.device,
                        f"still busy with an earlier flip after {BUSY_TRIES} tries",
                        "Restart the service; check the kernel log if it repeats",
                    ) from error
                with device_errors(self.device, "page flip"):
                    raise
        raise AssertionError  # the last try returned or raised

    def _finish(self, token: int, timeout_s: float) -> FlipStamp:
        with device_errors(self.device, "waiting for a vertical blank"):
            done = self._card.wait_flip(token, timeout_s)
        if done is None:
            self.check_connection()
            raise DeviceGone(
                self.device, f"no vertical blank within {timeout_s:g} s on {self.connector.name}", "Check its power"
            )
        self._pending = None
        self._pacer.shown(done.time_ns)
        return FlipStamp(self._counter.extend(done.raw_sequence), done.time_ns)

    # ---------------------------------------------------------------------------------- opening

    def _require_capabilities(self) -> None:
        with device_errors(self.device, "asking the card's capabilities"):
            dumb = self._card.capability(drm.CAP_DUMB_BUFFER)
            monotonic = self._card.capability(drm.CAP_TIMESTAMP_MONOTONIC)
        if not dumb:
            raise DeviceRefused(self.device, "the card has no dumb buffers", "Use a card with a KMS driver")
        if not monotonic:
            raise DeviceRefused(
                self.device, "flip times are not of the monotonic clock", "Boot without drm.timestamp_monotonic=0"
            )

    def _set_properties(self) -> None:
        for property_id, value in self.connector.properties.items():
            try:
                connector_property = self._card.property(property_id)
                choice = WANTED_PROPERTIES.get(connector_property.name)
                if choice is None or choice not in connector_property.choices:
                    continue
                if value != connector_property.choices[choice]:
                    self._card.set_property(self.connector.id, property_id, connector_property.choices[choice])
                self.details[connector_property.name] = choice
            except OSError as error:
                # The output works without this property: note it for `check`.
                self.details[f"property {property_id}"] = f"refused ({error.strerror})"

    def _linearise(self) -> None:
        try:
            self.details["gamma"] = "linear" if self._card.linear_gamma(self._crtc) else "no table"
        except OSError as error:
            self.details["gamma"] = f"unknown ({error.strerror})"
