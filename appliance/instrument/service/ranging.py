"""Owns the measuring of the distance on live images: which pairs are measured, when the lasers may go on, who is told.

The work is done in a thread of its own, ``kf-ranging``, on one pair at a time; a pair that comes while it works is left
out, since the next one comes a tenth of a second later. Every live view begins with the lasers off: what looks like a
dot then is remembered, and is a laser that ignores its switch if it looks no brighter with the lasers on.
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
"""Images after the lasers or the light were switched that may still be from before: two. Here and below: at least the
time, and more where live images come more slowly than ten a second."""
PAIR_NS, PAIR_IMAGES = 50_000_000, 0.5
"""Both images of a pair arrive within this; the next pair comes twice as late."""
DARK_PAIRS = 2
"""Pairs looked at before the lasers go on, and then again with them on."""
NO_BRIGHTER = 1.5
"""A dot of a laser that was just switched on is so much brighter than print or pebble were there before."""
CLEAR_PAIRS = 10
"""Number of pairs without a dot after which a laser that ignored its switch has gone off."""
HEARTBEATS_NS = 1_000_000_000
"""Two heartbeats of the board."""
SHINING_TIMEOUT_S = 3.0
"""Longest wait for one pair of images, behind another one: a hundred times what they take, and shorter than the
watchdog's patience."""
STALE_NS, STALE_IMAGES = 1_000_000_000, 10.0
IMAGES = "images"
"""The witness named in the fault, besides the board's read-back, which clears only its own."""


@dataclass(frozen=True, slots=True)
class _Measured:
    live: int
    """Number of the live view that it was measured in."""
    lit: bool
    dots: Dots
    range: Range | None


class RangingController:
    """Everything about the laser dots in live images that is neither a device nor a decision. A context manager.

    Called by the heartbeat only.
    """

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
        """Nothing is measured without ``pointers``.

        ``live_s``: from one live image to the next. ``memory``: of the beams, over a restart; written to in
        ``submit``'s thread whenever live views end.
        """
        live_ns = live_s * 1e9
        self._settle_ns = round(max(SETTLE_NS, SETTLE_IMAGES * live_ns))
        self._pair_ns = round(max(PAIR_NS, PAIR_IMAGES * live_ns))
        self._stale_ns = round(max(STALE_NS, STALE_IMAGES * live_ns))
        self._pointers, self._clock = pointers, clock
        self._calibration, self._water_index = calibration, water_index
        self._memory, self._submit = memory, submit
        self._written = 0
        """Dots that had taught the beams as they are on the disk."""
        self._marks: Marks | None = None
        """Made in ``kf-ranging``, whenever a dot has taught a beam; shown by the heartbeat."""
        self._executor = ThreadPoolExecutor(1, "kf-ranging")
        self._ranger: Ranger | None = None
        """Made and used in ``kf-ranging`` alone."""
        self._work: Future[_Measured] | None = None
        self._images: dict[str, tuple[int, NDArray[np.uint8]]] = {}
        self._live = 0
        self._wanted = self._lit = False
        self._ready_ns = 0
        """Time from which on images show the lasers as they are."""
        self._dark: list[Dots] = []
        self._lit_first: list[Dots] = []
        self._clear = 0
        self._lit_ns = 0
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
        """The object that measures, once a pair was measured."""
        return self._ranger

    @property
    def marks(self) -> Marks | None:
        """The places where the dots are going to be seen; ``None`` while the lasers are not on, or nobody knows yet."""
        return self._marks if self._lit else None

    def live(self, lasers: bool, calibration: Calibration, water_index: float) -> None:
        """Live views begin, with the lasers off; ``lasers``: they may go on when they were seen to be off."""
        self._end()
        if calibration is not self._calibration or water_index != self._water_index:
            self._calibration, self._water_index, self._ranger = calibration, water_index, None
            self._marks = None
        self._wanted = lasers and self._pointers is not None
        self._ready_ns = self._clock.now_ns() + self._settle_ns

    def stop(self) -> None:
        """Live views end; the lasers go off."""
        self._end()

    def see(self, side: str, image: NDArray[np.uint8]) -> None:
        """Take in a new live image of one camera, (h, w) uint8; it must not change any more."""
        now_ns = self._clock.now_ns()
        if self._pointers is None or now_ns < self._ready_ns:
            return
        self._images[side] = now_ns, image
        if any(one not in self._images for one in SIDES):
            return
        (left_ns, left), (right_ns, right) = (self._images[one] for one in SIDES)
        # While the lasers are about to go on, a pair might be half dark and half lit.
        if abs(left_ns - right_ns) > self._pair_ns or self._work is not None or self.wants_lasers:
            return
        self._images.clear()
        live, lit = self._live, self._lit
        shining = ("laser.left" not in self._failed, "laser.right" not in self._failed)
        self._work = self._executor.submit(self._measure, live, lit, shining, left, right)

    @property
    def wants_lasers(self) -> bool:
        """The dark was looked at: the lasers may go on now."""
        return self._wanted and not self._lit and len(self._dark) >= DARK_PAIRS and self._work is None

    def switched_on(self, state: LaserState) -> list[on.Event]:
        """Take over that the lasers were switched on, and what was read back of them."""
        self._lit = True
        self._images.clear()
        self._lit_ns = self._clock.now_ns()
        # Images on their way still show the dark: measured as lit ones, they would have no dots.
        self._ready_ns = self._lit_ns + self._settle_ns
        return self._read_back(state)

    def heard(self, state: LaserState) -> list[on.Event]:
        """Take in what a heartbeat of the board read back of the lasers."""
        old = self._clock.now_ns() < self._lit_ns + HEARTBEATS_NS  # it may be from before they were switched on
        return self._read_back(state) if self._lit and not old else []

    def _read_back(self, state: LaserState) -> list[on.Event]:
        events: list[on.Event] = []
        for side, conducts in (("left", state.left_on), ("right", state.right_on)):
            device = f"laser.{side}"
            if conducts and device in self._failed:
                self._failed.remove(device)
                events.append(on.ConditionCleared(FaultCode.LASER_FAILED, device))
            elif not conducts and device not in self._failed:
                self._failed.add(device)
                detail = f"the {side} laser does not conduct although switched on"
                events.append(on.ConditionRaised(Fault(FaultCode.LASER_FAILED, detail, device=device)))
        return events

    def poll(self) -> list[on.Event]:
        """Return what was measured since the last call."""
        if self._work is not None and self._work.done():
            work, self._work = self._work, None
            error = work.exception(0.0)
            if error is not None:
                log.error("no distance from the live images: %s", error, exc_info=error)
                return []
            measured = work.result(0.0)
            # Lasers or light may have been switched while it was measured.
            if measured.live == self._live and measured.lit == self._lit:
                return self._judge(measured)
        if self._shown is not None and self._clock.now_ns() - self._shown_ns > self._stale_ns:
            self._shown = None
            return [on.RangeMeasured(None)]
        return []

    def shining(self, bright: dict[str, NDArray[np.uint8]], dark: dict[str, NDArray[np.uint8]]) -> Fault | None:
        """Return the fault of a laser that shone in a sequence although it was switched off, from its bright and its
        dark frames.

        One of two witnesses: where it comes to no result, that is logged, and the board's read-back stands alone.
        """
        if self._pointers is None:
            return None
        pending = self._executor.submit(self._shining, bright, dark)
        try:
            return pending.result(SHINING_TIMEOUT_S)
        except TimeoutError:
            pending.cancel()
            log.warning("lasers in the dark frame: no answer within %g s", SHINING_TIMEOUT_S)
        except Exception as error:  # whatever it is, the scan is not to blame
            log.exception("lasers in the dark frame: not judged: %s", error)
        return None

    # ------------------------------------------------------------------------------------------ kf-ranging

    def _measure(
        self, live: int, lit: bool, shining: tuple[bool, bool], left: NDArray[np.uint8], right: NDArray[np.uint8]
    ) -> _Measured:
        ranger = self._made()
        dots = ranger.find((left, right), shining if lit else (True, True))
        known = ranger.beams
        if lit:
            ranger.learn(dots)
        if self._marks is None or ranger.beams != known:
            self._marks = ranger.marks()
        return _Measured(live, lit, dots, ranger.range_of(dots) if lit else None)

    def _shining(self, bright: dict[str, NDArray[np.uint8]], dark: dict[str, NDArray[np.uint8]]) -> Fault | None:
        found = shines_in_the_dark(self._made(), (bright["left"], bright["right"]), (dark["left"], dark["right"]))
        if not found:
            return None
        return Fault(FaultCode.LASER_ON, f"dot of the {' and '.join(found)} laser in the dark frame", device=IMAGES)

    def _made(self) -> Ranger:
        if self._ranger is None:
            assert self._pointers is not None
            calibration, memory = self._calibration, self._memory
            measured = calibration.method != DRAWN
            # Rays of cameras that were never measured meet beside the light: they teach no beam (`Ranger.learn`).
            beams = memory.read(calibration.hash) if measured and memory is not None else self._pointers.beams()
            self._ranger = Ranger(calibration.rig, self._water_index, beams, measured)
            self._written = _taught(beams)
        return self._ranger

    # ------------------------------------------------------------------------------------------ what it means

    def _end(self) -> None:
        # At the end of a live view, not after each dot: the disk is for scans.
        self._remember()
        self._live += 1
        if self._work is not None and self._work.cancel():
            self._work = None
        self._wanted = self._lit = False
        self._images.clear()
        self._dark.clear()
        self._lit_first.clear()
        self._clear = 0
        self._shown = None

    def _remember(self) -> None:
        """Let the disk have what the beams have learned since."""
        ranger, memory = self._ranger, self._memory
        if ranger is None or memory is None or self._submit is None or _taught(ranger.beams) == self._written:
            return
        beams, calibration_hash = ranger.beams, self._calibration.hash
        self._written = _taught(beams)

        def write() -> None:
            try:
                memory.write(calibration_hash, beams)
            except StorageError as error:
                log.warning("the laser beams are learned anew after the next start: %s", error)

        self._submit(write)

    def _judge(self, measured: _Measured) -> list[on.Event]:
        if not measured.lit:
            self._dark.append(measured.dots)
            # The latest ones: what lay before the instrument at first may have been moved away since.
            del self._dark[:-DARK_PAIRS]
            return self._cleared(measured.dots)
        events: list[on.Event] = [on.RangeMeasured(measured.range)]
        self._shown, self._shown_ns = measured.range, self._clock.now_ns()
        if len(self._lit_first) < DARK_PAIRS:
            self._lit_first.append(measured.dots)
            if len(self._lit_first) == DARK_PAIRS:
                events += self._compared()
        return events

    def _compared(self) -> list[on.Event]:
        """Return the fault of dots that were there with the lasers off and are no brighter with them on."""
        ignored = [
            side
            for side in SIDES
            if all(_same_dot(before, after) for before, after in _of(side, self._dark, self._lit_first))
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
        # Only while the lasers may not be on, as they may not while the condition lasts.
        if self._clear != CLEAR_PAIRS or self._wanted:
            return []
        return [on.ConditionCleared(FaultCode.LASER_ON, IMAGES)]


def _taught(beams: tuple[PointerBeam, PointerBeam]) -> int:
    """Return how many dots taught the beams."""
    return sum(beam.learned for beam in beams)


def _of(side: str, dark: list[Dots], lit: list[Dots]) -> list[tuple[Dot | None, Dot | None]]:
    return [(of_side(before, side), of_side(after, side)) for before, after in zip(dark, lit, strict=True)]


def _same_dot(before: Dot | None, after: Dot | None) -> bool:
    """Tell whether both cameras saw the dot before as after, and no brighter after."""
    if before is None or after is None or before.cameras < 2 or after.cameras < 2:
        return False
    return before.contrast_dn >= SURELY_A_DOT_DN and after.contrast_dn <= NO_BRIGHTER * before.contrast_dn
