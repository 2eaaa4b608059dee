"""A camera's sensor timing: which triggers start exposures, and when each image has left for the host.

Readout, the camera's bounded memory and the link follow from an exposure. Block ids count exposures, so that lost
images leave gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hw_sim.devices.board import Shot
from hw_sim.devices.power_on import CHOICES, POLITE, PowerOn
from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import WorldTime

READOUT_NS = 14_000_000
"""Readout time of the whole sensor, row by row: at most 71 frames a second."""
ROOM_BLOCKS = 4
"""Largest number of unread blocks of a host that keeps up; far fewer than overrun the memory."""
CONTINUOUS, SINGLE_FRAME, MULTI_FRAME = 0, 1, 2
LINE0, SOFTWARE = 0, 8
NOWHERE = 99
"""A line without a signal."""
RISING, FALLING, BOTH_EDGES = 0, 1, 2
TIMED, TRIGGER_WIDTH = 1, 2
AUTO_OFF, AUTO_CONTINUOUS = 0, 2
AUTO_EXPOSURE_US, AUTO_GAIN_TENTH_DB = 14_000, 120
"""Values of the automatic functions in the dark of a scan: more than any host sets."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """An exposure: light is collected from ``start_ns`` on."""

    start_ns: int
    duration_ns: int
    gain_db: float
    shot: Shot


class Latent(Protocol):
    """An image that is being made."""

    @property
    def ready(self) -> bool: ...

    @property
    def image(self) -> NDArray[np.uint8]:
        """Image (h, w) of the whole sensor; only when ``ready``."""

    def when_ready(self, action: Callable[[], None]) -> None:
        """Call ``action`` with the lock held, now or when the image is ready; in the order of the calls."""


@dataclass(slots=True)
class Settings:
    """The settings that a host may change; by default those of a free-running camera without trigger."""

    acquisition_mode: int = CONTINUOUS
    frame_count: int = 1
    frame_rate_mhz: int = 30_000
    trigger_on: int = 0
    trigger_source: int = LINE0
    trigger_activation: int = RISING
    exposure_mode: int = TIMED
    exposure_us: int = 5_000
    gain_tenth_db: int = 0
    exposure_auto: int = AUTO_OFF
    gain_auto: int = AUTO_OFF
    readout_ns: int = READOUT_NS
    """Duration of the readout of the whole sensor."""
    link_limit_ns: int = 0
    """Least duration of the readout by the limit of the link's throughput."""
    overlaps: bool = True
    """True if an exposure may begin during readout, by ``overlap_ns`` at most."""
    overlap_ns: int | None = None
    least_period_ns: int = 0
    """Least time between the starts of exposures."""
    trigger_delay_ns: int = 0
    width_offset_ns: int = 0
    """Exposure time beyond the width of a pulse."""
    held_by: int | None = None
    """Source of another trigger that must come before a frame; ``None``: there is no such trigger."""
    frames_each: int | None = None
    """Number of frames that each of those triggers allows; ``None``: all until the acquisition ends."""

    @classmethod
    def at_power_on(cls, state: PowerOn) -> Settings:
        """Return the settings of a camera after power-on."""
        settings = cls()
        for name in CHOICES:
            setattr(settings, name, state.register(name))
        return settings

    @property
    def used_exposure_us(self) -> int:
        """The duration of an exposure in mode Timed."""
        return self.exposure_us if self.exposure_auto == AUTO_OFF else AUTO_EXPOSURE_US

    @property
    def used_gain_db(self) -> float:
        """The gain of the image."""
        return (self.gain_tenth_db if self.gain_auto == AUTO_OFF else AUTO_GAIN_TENTH_DB) / 10


@dataclass(frozen=True, slots=True)
class ReadFrame:
    """A frame that left the sensor."""

    block_id: int
    exposure: Exposure
    latent: Latent | None
    """``None``: overrun, the image is lost."""


class Shutter:
    """The sensor's timing: ``expose(exposure)`` begins an image, ``send(frame)`` hands it to the link.

    ``expose`` returns ``None`` without room for another image. ``unread()`` counts the blocks the host has not read,
    ``link_ns()`` is the link's time for a payload, ``rows()`` the fraction of the sensor's rows that is read.
    """

    def __init__(
        self,
        name: str,
        time: WorldTime,
        faults: FaultBook,
        expose: Callable[[Exposure], Latent | None],
        send: Callable[[ReadFrame], None],
        unread: Callable[[], int],
        link_ns: Callable[[], int],
        rows: Callable[[], float],
        power_on: PowerOn = POLITE,
    ) -> None:
        self._name, self._time, self._faults = name, time, faults
        self._expose, self._send, self._unread, self._link_ns, self._rows = expose, send, unread, link_ns, rows
        self._power_on = power_on
        self.settings = Settings.at_power_on(power_on)
        self.acquiring = False
        self.ignored = 0
        """Triggers that came while a frame was exposed or could not have been read out."""
        self._life = 0
        self._free_run_number = 0
        """Number of the free run that goes on; those before it have ended."""
        self._block_id = 0
        self._left: int | None = None
        self._allowed: int | None = None
        """Number of frames that the trigger before the frames' own still allows; ``None``: any."""
        self._begun_ns = -(10**18)
        self.exposing_until_ns = 0
        self._readout_until_ns = 0
        self._link_free_ns = 0
        self._held = 0
        """Frames in the camera's memory that are not yet with the link."""
        self._frozen: Latent | None = None

    def power_up(self) -> None:
        """Set settings and counters as after plugging in."""
        self.stop()
        self._begin_life()
        self.exposing_until_ns = self._readout_until_ns = 0
        self.settings = Settings.at_power_on(self._power_on)

    def _begin_life(self) -> None:
        """Drop all images that are under way: they never arrive, and keep neither memory nor link busy."""
        self._life += 1
        self._held = 0
        self._link_free_ns = 0

    def start(self) -> None:
        """Begin an acquisition; block ids begin at 0."""
        s = self.settings
        if self.acquiring:
            return
        self._begin_life()
        self.acquiring = True
        self._block_id = 0
        self._left = {SINGLE_FRAME: 1, MULTI_FRAME: s.frame_count}.get(s.acquisition_mode)
        self._allowed = None if s.held_by is None else 0
        self._begun_ns = -(10**18)
        self.trigger_mode_changed()

    def stop(self) -> None:
        """End the acquisition; images that are exposed or under way still come."""
        self.acquiring = False

    # ------------------------------------------------------------------------------------------ triggers

    def line0(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        """Handle a pulse of the trigger line that rises at ``time_ns``."""
        s = self.settings
        if s.held_by == LINE0 and self._allowed == 0:
            self._let_frames_begin(time_ns, shot)
            return
        if not s.trigger_on or s.trigger_source != LINE0:
            return
        start_ns = time_ns + (width_ns if s.trigger_activation == FALLING else 0) + s.trigger_delay_ns
        late = self._faults.strike(self._name, "delayed", frame=shot.frame)
        if late is not None:
            start_ns += int(late.amount * 1e6)
        by_width = s.exposure_mode == TRIGGER_WIDTH
        duration_ns = width_ns + s.width_offset_ns if by_width else s.used_exposure_us * 1000
        self._at(start_ns, lambda t: self._trigger(Exposure(t, duration_ns, s.used_gain_db, shot)))
        if s.trigger_activation == BOTH_EDGES:
            self._at(start_ns + width_ns, lambda t: self._trigger(Exposure(t, duration_ns, s.used_gain_db, shot)))

    def _let_frames_begin(self, time_ns: int, shot: Shot) -> None:
        """Handle the trigger that precedes the frames' trigger."""
        s = self.settings
        self._allowed = s.frames_each
        if not s.trigger_on and self._allowed == 1:
            duration_ns = s.used_exposure_us * 1000
            self._at(time_ns, lambda t: self._trigger(Exposure(t, duration_ns, s.used_gain_db, shot)))
        elif not s.trigger_on:
            self.trigger_mode_changed()

    def software_hold(self) -> None:
        """Handle the host's command for the trigger that precedes the frames' trigger."""
        if self.settings.held_by == SOFTWARE and self._allowed == 0:
            self._let_frames_begin(self._time.now_ns(), Shot(0, self._block_id, None))

    def software(self) -> None:
        """Handle the host's trigger command."""
        s = self.settings
        if s.trigger_on and s.trigger_source == SOFTWARE:
            self._trigger(self._own_exposure(self._time.now_ns()))

    def trigger_mode_changed(self) -> None:
        """Note a change of the trigger mode: off during an acquisition starts a free run, but no second one."""
        self._free_run_number += 1
        if self.acquiring and not self.settings.trigger_on:
            self._free_run(self._free_run_number, self._time.now_ns())

    def _free_run(self, number: int, time_ns: int) -> None:
        if number != self._free_run_number or not self.acquiring or self.settings.trigger_on:
            return
        self._trigger(self._own_exposure(time_ns))
        # The frame rate is in mHz; no exposure is cut short for it.
        period_ns = max(10**12 // self.settings.frame_rate_mhz, self.settings.used_exposure_us * 1000)
        self._time.at(time_ns + period_ns, lambda t: self._free_run(number, t))

    def _own_exposure(self, time_ns: int) -> Exposure:
        s = self.settings
        return Exposure(time_ns, s.used_exposure_us * 1000, s.used_gain_db, Shot(0, self._block_id, None))

    # ------------------------------------------------------------------------------------------ exposure to link

    def _at(self, time_ns: int, action: Callable[[int], None], ready: Callable[[], bool] | None = None) -> None:
        """Put ``action`` on the world's agenda; another acquisition cancels it."""
        life = self._life

        def alive(t: int) -> None:
            if self._life == life:
                action(t)

        # A cancelled action also waits for its image, so that images are made in order.
        self._time.at(time_ns, alive, ready)

    def _trigger(self, exposure: Exposure) -> None:
        end_ns = exposure.start_ns + exposure.duration_ns
        if not self.acquiring:
            return
        # A trigger is ignored while the sensor is exposed, or if its image would be ready before the last one is read out.
        if exposure.start_ns < self.exposing_until_ns or end_ns < self._readout_until_ns or not self._lets(exposure):
            self.ignored += 1
            return
        self._begun_ns = exposure.start_ns
        if self._allowed is not None:
            self._allowed -= 1
        block_id = self._block_id
        self._block_id += 1
        if self._left is not None:
            self._left -= 1
            # The last frame ends its acquisition; exposed images still come.
            self.acquiring = self._left > 0
        self.exposing_until_ns = end_ns
        s = self.settings
        self._readout_until_ns = end_ns + max(int(s.readout_ns * self._rows()), s.link_limit_ns)
        self._at(end_ns, lambda _: self._exposed(block_id, exposure))

    def _lets(self, exposure: Exposure) -> bool:
        """Return True if overlap, frame rate and another trigger allow this exposure."""
        s = self.settings
        earliest_ns = self._begun_ns + s.least_period_ns
        if not s.overlaps:
            earliest_ns = max(earliest_ns, self._readout_until_ns)
        elif s.overlap_ns is not None:
            earliest_ns = max(earliest_ns, self._readout_until_ns - s.overlap_ns)
        return exposure.start_ns >= earliest_ns and self._allowed != 0

    def _exposed(self, block_id: int, exposure: Exposure) -> None:
        # Overrun: with the memory full the image is lost, but its block id is used up.
        latent = self._image(exposure) if self._held + self._unread() < self._power_on.memory_blocks else None
        free_ns = max(self._readout_until_ns, self._link_free_ns)
        if latent is None:
            # After those that wait for the link, so that block ids leave in order.
            self._at(free_ns, lambda _: self._send(ReadFrame(block_id, exposure, None)))
            return
        self._held += 1
        due_ns = self._link_free_ns = free_ns + self._link_ns()

        def due(_: int) -> None:
            latent.when_ready(leave)

        life = self._life

        def leave() -> None:
            if self._life == life:
                self._held -= 1
                self._send(ReadFrame(block_id, exposure, latent))

        self._at(due_ns, due, lambda: latent.ready)

    def _image(self, exposure: Exposure) -> Latent | None:
        """Return a new image, or the last one again while the sensor is stuck."""
        if self._frozen is None or self._faults.active(self._name, "stuck") is None:
            self._frozen = self._expose(exposure)
        return self._frozen
