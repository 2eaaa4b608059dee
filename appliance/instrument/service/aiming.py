"""Warnings of the live views: causes for which a scan would fail now, from the live images.

Images of the left camera are measured in a thread of its own, ``kf-aiming``, one at a time (2 ms); images that come
meanwhile are skipped. A warning comes with the third consecutive image with the fault, and goes with the third without.
It forbids nothing.
"""

from __future__ import annotations

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.aiming import WIDTH_PX, LiveImage, displacement_px, measure_image, too_fast
from appliance.instrument.machine import events as on
from appliance.instrument.ranging.expected_light import DrawnLight
from appliance.measure import NOMINAL, Calibration, Exposure, Fault, FaultCode
from drivers.api import Clock

log = logging.getLogger("kingfisher")

SIDE = "left"
DEVICE = "live view"
"""Device named in the conditions, so that only this witness clears them."""
SETTLE_S, SETTLE_IMAGES = 0.3, 3.0
"""Time and number of images after switching the light that may still show the state before."""
VOTES = 3
"""Number of consecutive images."""
MOST_APART = 3
"""Largest difference of the numbers of two images that motion is measured from."""
CODES = (FaultCode.AIM_LIGHT, FaultCode.AIM_TURBID, FaultCode.AIM_DARK, FaultCode.AIM_FAST)


@dataclass(frozen=True, slots=True, eq=False)
class _JudgedImage:
    live: int
    """Number of the live view of the image."""
    number: int
    image_measures: LiveImage
    faults: tuple[Fault, ...]


class AimingController:
    """Judges live images. A context manager; called only by the service's cycle."""

    def __init__(self, clock: Clock, live_s: float, black_dn: float, light: DrawnLight) -> None:
        """Prepare the checks.

        ``live_s``: from one live image to the next; ``black_dn``: the cameras' black level; ``light``: of the live
        views.
        """
        self._clock, self._live_s, self._black_dn, self._light = clock, live_s, black_dn, light
        self._settle_ns = round(1e9 * max(SETTLE_S, SETTLE_IMAGES * live_s))
        # One thread and one image at a time, without a queue: a warning may come late by an image.
        self._executor = ThreadPoolExecutor(1, "kf-aiming")
        self._work: Future[_JudgedImage] | None = None
        self._live = 0
        self._watching = False
        self._ready_ns = 0
        self._mm_per_px = 0.0
        self._seen_by: tuple[Calibration, float, float] | None = None
        """Calibration, refractive index of the water, and the exposure's light as a multiple of the nominal one's."""
        self._shade: tuple[Calibration, float, NDArray[np.bool_] | None] | None = None
        """Made and used only in ``kf-aiming``, for one calibration and one water."""
        self._last: _JudgedImage | None = None
        self._votes = dict.fromkeys(CODES, 0)
        self._raised: set[FaultCode] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)

    def live(
        self, is_lit: bool, calibration: Calibration, water_index: float, exposure: Exposure = NOMINAL
    ) -> list[on.Event]:
        """Begin live views for aiming; images without the projector's light (``is_lit``) are not judged."""
        events = self.stop()
        self._watching = is_lit
        self._ready_ns = self._clock.now_ns() + self._settle_ns
        self._mm_per_px = _mm_per_px(calibration, water_index)
        self._seen_by = calibration, water_index, exposure.light / NOMINAL.light
        return events

    def stop(self) -> list[on.Event]:
        """End the live views and their warnings."""
        # By this number `poll` recognises results of an earlier live view.
        self._live += 1
        self._watching, self._last = False, None
        self._votes = dict.fromkeys(CODES, 0)
        raised, self._raised = self._raised, set()
        return [on.ConditionCleared(code, DEVICE) for code in CODES if code in raised]

    def see(self, side: str, number: int, image: NDArray[np.uint8]) -> None:
        """Take a new live image of one camera, (h, w) uint8, with its running ``number``.

        The image must not change any more.
        """
        # Only the left camera: the right one sees the same light, backscatter and motion.
        if not self._watching or side != SIDE or self._work is not None or self._clock.now_ns() < self._ready_ns:
            return
        self._work = self._executor.submit(self._look, self._live, number, image, self._last)

    @property
    def busy(self) -> bool:
        """True while an image is being measured."""
        return self._work is not None and not self._work.done()

    def poll(self) -> list[on.Event]:
        """Return the results since the last call."""
        if self._work is None or not self._work.done():
            return []
        work, self._work = self._work, None
        error = work.exception(0.0)
        if error is not None:
            log.error("live images are not judged: %s", error, exc_info=error)
            return []
        judged_image = work.result(0.0)
        if judged_image.live != self._live:
            return []
        self._last = judged_image
        events: list[on.Event] = []
        for code in CODES:
            fault = next((candidate for candidate in judged_image.faults if candidate.code is code), None)
            events += self._voted(code, fault)
        return events

    def _voted(self, code: FaultCode, fault: Fault | None) -> list[on.Event]:
        # Votes are images that contradict the present warning; one that agrees with it resets them.
        if (fault is None) == (code not in self._raised):
            self._votes[code] = 0
            return []
        self._votes[code] += 1
        if self._votes[code] < VOTES:
            return []
        self._votes[code] = 0
        if fault is None:
            self._raised.discard(code)
            return [on.ConditionCleared(code, DEVICE)]
        self._raised.add(code)
        return [on.ConditionRaised(fault)]

    # ------------------------------------------------------------------------------------------ kf-aiming

    def _look(self, live: int, number: int, image: NDArray[np.uint8], last: _JudgedImage | None) -> _JudgedImage:
        # Read once: the service may begin another live view meanwhile, which `poll` recognises.
        seen_by = self._seen_by
        shade, longer = (None, 1.0) if seen_by is None else (self._shade_of(*seen_by[:2]), seen_by[2])
        image_measures = measure_image(image, self._black_dn, shade)
        faults = [image_measures.fault(longer)]
        # Images farther apart differ too much to be tracked; numbers begin again when a camera came back.
        if last is not None and 0 < number - last.number <= MOST_APART:
            moved_px = displacement_px(last.image_measures, image_measures)
            if moved_px is not None:
                faults.append(too_fast(moved_px * self._mm_per_px / (self._live_s * (number - last.number))))
        named_faults = tuple(_for_live_view(fault) for fault in faults if fault is not None)
        return _JudgedImage(live, number, image_measures, named_faults)

    def _shade_of(self, calibration: Calibration, water_index: float) -> NDArray[np.bool_] | None:
        """Return the pixels that the live light does not reach; takes 20 ms for each calibration and water."""
        if self._shade is None or self._shade[0] is not calibration or self._shade[1] != water_index:
            self._shade = calibration, water_index, self._light.shade(calibration.rig, water_index, WIDTH_PX)
        return self._shade[2]


def _for_live_view(fault: Fault) -> Fault:
    return Fault(fault.code, fault.detail, fault.numbers, DEVICE)


def _mm_per_px(calibration: Calibration, water_index: float) -> float:
    """Return the length in mm of a pixel of a reduced image in the middle of the volume."""
    camera = calibration.rig.left
    middle = np.array([(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0])
    step_px = camera.width_px / WIDTH_PX
    # The angle between two rays in water times the distance, refraction included.
    _, along = camera.rays(np.stack([middle, middle + np.array([step_px, 0.0])]), water_index)
    reach_mm = float(np.linalg.norm(calibration.rig.volume_centre_mm(water_index)))
    return reach_mm * float(np.linalg.norm(along[1] - along[0]))
