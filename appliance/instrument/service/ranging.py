"""Control of the ranging in live images: choice of stereo pairs, release of the lasers, and events.

The work is done in a thread of its own, ``kf-ranging``, on one pair at a time; pairs that come meanwhile are skipped,
since the next one follows a tenth of a second later. Every live view begins with the lasers off: spots that look like a
dot then are recorded. If they are no brighter with the lasers on, a laser ignored its switch.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine import events as on
from appliance.instrument.ranging.beams import PointerBeam, Pointers
from appliance.instrument.ranging.ranger import SURELY_A_DOT_DN, Dot, Dots, Ranger, shines_in_the_dark
from appliance.instrument.ranging.reach import Marks, Range
from appliance.instrument.service.remembered import BeamsFile
from appliance.measure import METHOD as DRAWN
from appliance.measure import SIDES, Calibration, Fault, FaultCode, of_side
from appliance.store import StorageError
from drivers.api import Clock, LaserState

log = logging.getLogger("kingfisher")

SETTLE_NS, SETTLE_IMAGES = 200_000_000, 2.0
"""Time and number of images after switching lasers or light that may still show the state before.

Here and below: at least the time, and longer where live images come more slowly than ten a second.
"""
PAIR_NS, PAIR_IMAGES = 50_000_000, 0.5
"""Largest time between both images of a pair; the next pair comes after twice the time."""
DARK_PAIRS = 2
"""Number of pairs examined before the lasers go on, and again with them on."""
NO_BRIGHTER = 1.5
"""Ratio by which the dot of a laser that was just switched on exceeds print or pebbles there before."""
CLEAR_PAIRS = 10
"""Number of pairs without a dot after which a laser that ignored its switch counts as off."""
HEARTBEATS_NS = 1_000_000_000
"""Two heartbeats of the board."""
SHINING_TIMEOUT_S = 3.0
"""Longest wait for one pair of images, after another one.

A hundred times their duration, and shorter than the watchdog's limit.
"""
STALE_NS, STALE_IMAGES = 1_000_000_000, 10.0
IMAGES = "images"
"""Witness named in the fault; the board, the other witness, clears only its own."""


@dataclass(frozen=True, slots=True)
class _Measurement:
    live: int
    """Number of the live view in which it was measured."""
    is_on: bool
    dots: Dots
    range: Range | None


class RangingController:
    """Control of the ranging in live images. A context manager; called only by the service's cycle."""

    def __init__(
        self,
        pointers: Pointers | None,
        calibration: Calibration,
        water_index: float,
        clock: Clock,
        live_s: float,
        memory: BeamsFile | None = None,
        submit: Callable[[Callable[[], None]], object] | None = None,
    ) -> None:
        """Prepare; without ``pointers`` there is no ranging.

        ``live_s``: from one live image to the next. ``memory``: file of the corrected beams; written in ``submit``'s
        thread whenever live views end.
        """
        live_ns = live_s * 1e9
        self._settle_ns = round(max(SETTLE_NS, SETTLE_IMAGES * live_ns))
        self._pair_ns = round(max(PAIR_NS, PAIR_IMAGES * live_ns))
        self._stale_ns = round(max(STALE_NS, STALE_IMAGES * live_ns))
        self._pointers, self._clock = pointers, clock
        self._calibration, self._water_index = calibration, water_index
        self._memory, self._submit = memory, submit
        self._written = 0
        """Number of dots in the beams on the disk."""
        self._marks: Marks | None = None
        """Made in ``kf-ranging``, whenever a dot has updated a beam; shown by the service."""
        self._executor = ThreadPoolExecutor(1, "kf-ranging")
        self._ranger: Ranger | None = None
        """Made and used only in ``kf-ranging``."""
        self._work: Future[_Measurement] | None = None
        self._images: dict[str, tuple[int, NDArray[np.uint8]]] = {}
        self._live = 0
        self._wanted = self._is_on = False
        self._ready_ns = 0
        """Time from which images show the present state of the lasers."""
        self._dark: list[Dots] = []
        self._first_on: list[Dots] = []
        self._clear = 0
        self._on_ns = 0
        self._failed: set[str] = set()
        self._shown: Range | None = None
        self._shown_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)

    @property
    def ranger(self) -> Ranger | None:
        """The ranger, once a pair was measured."""
        return self._ranger

    @property
    def marks(self) -> Marks | None:
        """Positions where the dots will appear; ``None`` while the lasers are off, or before the first pair."""
        return self._marks if self._is_on else None

    def live(self, lasers: bool, calibration: Calibration, water_index: float) -> None:
        """Begin live views, with the lasers off; ``lasers``: they may go on after a check."""
        self._end()
        if calibration is not self._calibration or water_index != self._water_index:
            self._calibration, self._water_index, self._ranger = calibration, water_index, None
            self._marks = None
        self._wanted = lasers and self._pointers is not None
        self._ready_ns = self._clock.now_ns() + self._settle_ns

    def stop(self) -> None:
        """End the live views; the lasers go off."""
        self._end()

    def see(self, side: str, image: NDArray[np.uint8]) -> None:
        """Take a new live image of one camera, (h, w) uint8; it must not change any more."""
        now_ns = self._clock.now_ns()
        if self._pointers is None or now_ns < self._ready_ns:
            return
        self._images[side] = now_ns, image
        if any(name not in self._images for name in SIDES):
            return
        (left_ns, left), (right_ns, right) = (self._images[name] for name in SIDES)
        # While the lasers are about to go on, the images of a pair might differ in that.
        if abs(left_ns - right_ns) > self._pair_ns or self._work is not None or self.wants_lasers:
            return
        self._images.clear()
        live, is_on = self._live, self._is_on
        shining = ("laser.left" not in self._failed, "laser.right" not in self._failed)
        self._work = self._executor.submit(self._measure, live, is_on, shining, left, right)

    @property
    def wants_lasers(self) -> bool:
        """True if the images without lasers were examined, so that they may go on."""
        return self._wanted and not self._is_on and len(self._dark) >= DARK_PAIRS and self._work is None

    def switched_on(self, state: LaserState) -> list[on.Event]:
        """Record that the lasers were switched on, and check the state that the board read back."""
        self._is_on = True
        self._images.clear()
        self._on_ns = self._clock.now_ns()
        # Images that are on their way still show no dots.
        self._ready_ns = self._on_ns + self._settle_ns
        return self._read_back(state)

    def heard(self, state: LaserState) -> list[on.Event]:
        """Check the lasers' state in a heartbeat of the board."""
        old = self._clock.now_ns() < self._on_ns + HEARTBEATS_NS  # the report may be older than the switching
        return self._read_back(state) if self._is_on and not old else []

    def _read_back(self, state: LaserState) -> list[on.Event]:
        events: list[on.Event] = []
        for side, conducts in (("left", state.left_on), ("right", state.right_on)):
            device = f"laser.{side}"
            if conducts and device in self._failed:
                self._failed.remove(device)
                events.append(on.ConditionCleared(FaultCode.LASER_FAILED, device))
            elif not conducts and device not in self._failed:
                self._failed.add(device)
                detail = f"the {side} laser does not conduct although it is switched on"
                events.append(on.ConditionRaised(Fault(FaultCode.LASER_FAILED, detail, device=device)))
        return events

    def poll(self) -> list[on.Event]:
        """Return the results since the last call."""
        if self._work is not None and self._work.done():
            work, self._work = self._work, None
            error = work.exception(0.0)
            if error is not None:
                log.error("no distance from the live images: %s", error, exc_info=error)
                return []
            measured = work.result(0.0)
            # Lasers or light may have been switched while it was measured.
            if measured.live == self._live and measured.is_on == self._is_on:
                return self._judge(measured)
        if self._shown is not None and self._clock.now_ns() - self._shown_ns > self._stale_ns:
            self._shown = None
            return [on.RangeMeasured(None)]
        return []

    def shining(self, bright: dict[str, NDArray[np.uint8]], dark: dict[str, NDArray[np.uint8]]) -> Fault | None:
        """Return a fault if a laser shone in a sequence, from its bright and its dark frames.

        One of two witnesses: if it has no result, that is logged, and the board's report stands alone.
        """
        if self._pointers is None:
            return None
        pending = self._executor.submit(self._shining, bright, dark)
        try:
            return pending.result(SHINING_TIMEOUT_S)
        except TimeoutError:
            pending.cancel()
            log.warning("search for laser dots in the dark frame: no answer within %g s", SHINING_TIMEOUT_S)
        except Exception as error:  # an error of this check must not spoil the scan
            log.exception("the dark frame is not searched for laser dots: %s", error)
        return None

    # ------------------------------------------------------------------------------------------ kf-ranging

    def _measure(
        self, live: int, is_on: bool, shining: tuple[bool, bool], left: NDArray[np.uint8], right: NDArray[np.uint8]
    ) -> _Measurement:
        ranger = self._current_ranger()
        dots = ranger.find((left, right), shining if is_on else (True, True))
        earlier_beams = ranger.beams
        if is_on:
            ranger.learn(dots)
        if self._marks is None or ranger.beams != earlier_beams:
            self._marks = ranger.marks()
        return _Measurement(live, is_on, dots, ranger.range_of(dots) if is_on else None)

    def _shining(self, bright: dict[str, NDArray[np.uint8]], dark: dict[str, NDArray[np.uint8]]) -> Fault | None:
        sides = shines_in_the_dark(
            self._current_ranger(), (bright["left"], bright["right"]), (dark["left"], dark["right"])
        )
        if not sides:
            return None
        return Fault(FaultCode.LASER_ON, f"dot of the {' and '.join(sides)} laser in the dark frame", device=IMAGES)

    def _current_ranger(self) -> Ranger:
        if self._ranger is None:
            assert self._pointers is not None
            calibration, memory = self._calibration, self._memory
            measured = calibration.method != DRAWN
            # With a nominal calibration rays do not meet at the dot, so there are no corrected beams (`Ranger.learn`).
            beams = memory.read(calibration.hash) if measured and memory is not None else self._pointers.beams()
            self._ranger = Ranger(calibration.rig, self._water_index, beams, measured)
            self._written = _dot_count(beams)
        return self._ranger

    # ------------------------------------------------------------------------------------------ what it means

    def _end(self) -> None:
        # Written at the end of a live view, not after each dot, to keep the disk free for scans.
        self._remember()
        self._live += 1
        if self._work is not None and self._work.cancel():
            self._work = None
        self._wanted = self._is_on = False
        self._images.clear()
        self._dark.clear()
        self._first_on.clear()
        self._clear = 0
        self._shown = None

    def _remember(self) -> None:
        """Let the disk's thread write the beams, if they have changed."""
        ranger, memory = self._ranger, self._memory
        if ranger is None or memory is None or self._submit is None or _dot_count(ranger.beams) == self._written:
            return
        beams, calibration_hash = ranger.beams, self._calibration.hash
        self._written = _dot_count(beams)

        def write() -> None:
            try:
                memory.write(calibration_hash, beams)
            except StorageError as error:
                log.warning("the laser beams are measured again after the next start: %s", error)

        self._submit(write)

    def _judge(self, measured: _Measurement) -> list[on.Event]:
        if not measured.is_on:
            self._dark.append(measured.dots)
            # Only the latest ones, since the scene may have changed.
            del self._dark[:-DARK_PAIRS]
            return self._cleared(measured.dots)
        events: list[on.Event] = [on.RangeMeasured(measured.range)]
        self._shown, self._shown_ns = measured.range, self._clock.now_ns()
        if len(self._first_on) < DARK_PAIRS:
            self._first_on.append(measured.dots)
            if len(self._first_on) == DARK_PAIRS:
                events += self._compared()
        return events

    def _compared(self) -> list[on.Event]:
        """Return a fault if dots were there with the lasers off and are no brighter with them on."""
        ignored = [
            side
            for side in SIDES
            if all(_same_dot(before, after) for before, after in _dots_of_side(side, self._dark, self._first_on))
        ]
        if not ignored:
            return []
        sides = " and ".join(ignored)
        return [
            on.ConditionRaised(Fault(FaultCode.LASER_ON, f"dot of the {sides} laser seen while off", device=IMAGES))
        ]

    def _cleared(self, dots: Dots) -> list[on.Event]:
        shines = any(dot.cameras == 2 and dot.contrast_dn >= SURELY_A_DOT_DN for dot in dots.present)
        self._clear = 0 if shines else self._clear + 1
        # Only while the lasers are off, as they are while the condition lasts.
        if self._clear != CLEAR_PAIRS or self._wanted:
            return []
        return [on.ConditionCleared(FaultCode.LASER_ON, IMAGES)]


def _dot_count(beams: tuple[PointerBeam, PointerBeam]) -> int:
    """Return the number of dots that updated the beams."""
    return sum(beam.learned for beam in beams)


def _dots_of_side(side: str, dark: list[Dots], lasers_on: list[Dots]) -> list[tuple[Dot | None, Dot | None]]:
    return [(of_side(before, side), of_side(after, side)) for before, after in zip(dark, lasers_on, strict=True)]


def _same_dot(before: Dot | None, after: Dot | None) -> bool:
    """Return True if both cameras saw the dot before and after, and no brighter after."""
    if before is None or after is None or before.cameras < 2 or after.cameras < 2:
        return False
    return before.contrast_dn >= SURELY_A_DOT_DN and after.contrast_dn <= NO_BRIGHTER * before.contrast_dn
