"""Owns the order of work on a scan: the right patterns? the coarse cloud; what the judges say; the full cloud.

The instrument's worker and the desk go through it alike, so that the same frames get the same points and verdicts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.attempt import Attempt, attempt
from appliance.optics.water import Water
from appliance.reconstruct.decode import DecodedMaps
from appliance.reconstruct.images import ScanImages
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.specks import mask_specks
from appliance.reconstruct.table import Found
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.sides import SIDES, of_side
from appliance.scan.verdict import Judgement, Verdict
from appliance.verdict.causes import with_causes
from appliance.verdict.identity import judge_identity
from appliance.verdict.light import judge_light
from appliance.verdict.motion import MotionJudgement, judge_motion
from appliance.verdict.sight import look
from appliance.verdict.turbidity import judge_water
from appliance.verdict.window import Windows, look_at_windows
from appliance.worker.pair import Merged, Sequence, merge_pair

WORTH_MASKING_PERCENT = 0.02
"""Of the pixels with coordinates; where specks disturb fewer, they are not looked for one by one: 20 ms of a scan."""

SIGHT_POINTS = 7_500
"""Left pixels that are asked at what depth, near or far, they see something."""


class ScanWork:
    """One scan after the other through ``pipeline`` and past the judges.

    The order is ``begin``, ``push`` for every frame, ``identify``, ``find_coarse``, ``judge``, ``compensate`` where ``moved``,
    ``find_full``. A second sequence with another exposure follows in the same order, between ``hold`` and ``merge_with``.
    """

    def __init__(self, pipeline: Pipeline, calibration: Calibration, water: Water) -> None:
        self._pipeline = pipeline
        self._calibration, self._water = calibration, water
        self._settings = AcquisitionSettings()
        self._frames: dict[str, NDArray[np.uint8]] = {}
        self._coarse: Found | None = None
        self._specks = False
        self._motion: MotionJudgement | None = None
        self.windows: Windows | None = None
        """After ``judge``: what the scan says of the cameras' windows; ``None``: nothing, since something moved."""
        self._identity: Judgement | None = None
        self._judged: tuple[Judgement, ...] = ()
        """As the judges said it, each by itself."""
        self._found: Found | None = None
        self._compensated: Found | None = None
        self._full: Found | None = None

    def begin(self, settings: AcquisitionSettings) -> None:
        """The next frame is frame 0 of a scan that was taken so."""
        self._settings, self._coarse, self._specks = settings, None, False
        self.windows = self._motion = self._found = self._compensated = self._full = None
        self._identity = None
        self._frames.clear()
        self._pipeline.expect(settings.noise)
        self._pipeline.reset()

    def push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        """Frame ``index`` of one side's ``frames`` (n, h, w) uint8, which must not change until the full cloud is found.

        Raises ValueError unless frames come as 0, 1, …
        """
        self._frames[side] = frames
        self._pipeline.push(side, frames, index)

    def identify(self) -> Judgement:
        """Whether each frame shows the pattern it should; after the last one. With a fault, points would mean nothing."""
        settings = self._settings
        self._identity = judge_identity(self._frames, self._pipeline.sequence, settings.noise, settings.exposure)
        return self._identity

    def find_coarse(self) -> Found:
        """The coarse cloud; after the last frame."""
        self._coarse = self._pipeline.find_coarse()
        return self._coarse

    def judge(self, done: Callable[[], None] = lambda: None) -> tuple[Judgement, ...]:
        """What is to be said of the scan; ``done`` is called after each judge but the last. Raises ValueError unless called
        after ``find_coarse``."""
        if self._coarse is None:
            raise ValueError("nothing was found to be judged; ask for the coarse cloud first")
        recorded, rig, index = self._recorded(), self._calibration.rig, self._water.index
        cloud = self._pipeline.table.cloud(self._coarse)
        water = judge_water(recorded, cloud, rig, index)
        self._specks = (water.speck_percent or 0.0) > WORTH_MASKING_PERCENT
        done()
        light = judge_light(recorded, self._settings.exposure, self._settings.steps)
        done()
        self._motion = judge_motion(recorded, cloud, rig, index)
        done()
        self.windows = None if self.moved else look_at_windows(recorded)
        others: tuple[Judgement, ...] = (light, water.judgement, Judgement(self._look(recorded)))
        if self.windows is not None:
            others += (Judgement(self.windows.verdict()),)
        self._judged = (*others, self._motion.judgement)
        return self._weighed(self._coarse.summary)

    @property
    def moved(self) -> bool:
        """After ``judge``: instrument and scene moved against each other, and it can be tried to take that out."""
        return self._motion is not None and self._motion.judgement.fault is not None

    def compensate(self) -> tuple[Judgement, ...]:
        """Try to take the motion out of the points; what is to be said of the scan then, in place of what ``judge`` said.

        The full cloud will be that of one moment of the scan where that makes it good, else the plain one.
        """
        if self._motion is None or self._coarse is None:
            raise ValueError("nothing was judged that could be compensated; ask for the judgements first")
        others, motion, recorded = self._judged[:-1], self._motion.judgement, self._recorded()
        plain = self._pipeline.find_full()
        tried = attempt(self._pipeline, plain, recorded, self._calibration, self._water)
        self._compensated = tried.found
        self._found = tried.found or plain
        if tried.found is not None:
            motion = replace(motion, fault=Fault(FaultCode.COMPENSATED, motion.verdict.text))
        self._judged = (*others, motion, Judgement(_compensation(tried, recorded.frame_s)))
        return self._weighed(self._found.summary)

    def find_full(self) -> Found:
        """The full cloud; after ``judge``. What passed by makes no points."""
        if self._found is None and self._specks:
            for side in SIDES:
                mask_specks(
                    self._pipeline.sequence,
                    self._frames[side],
                    self._pipeline.decoded(side),
                    of_side(self._settings.noise, side),
                )
        self._full = self._found or self._pipeline.find_full()
        return self._full

    def conclude(self) -> tuple[Judgement, ...]:
        """What is to be said of the scan once its full cloud is known, in place of what was said before. Raises ValueError
        unless called after ``find_full``."""
        if self._full is None:
            raise ValueError("the scan has no full cloud yet; ask for it before concluding")
        return self._weighed(self._full.summary)

    def _weighed(self, summary: CloudSummary) -> tuple[Judgement, ...]:
        return with_causes(self._judged, summary, self._settings.exposure, self._settings.steps)

    def _look(self, recorded: ScanImages) -> Verdict:
        """At what is there at whatever depth, and at fringes too weak to be decoded."""
        left = self._calibration.rig.left
        parallax = None if self._identity is None else self._identity.verdict.numbers.get("parallax_percent")
        stride = max(1, round((left.width_px * left.height_px / SIGHT_POINTS) ** 0.5))
        loose = self._pipeline.sample(stride, any_depth=True)
        return look(
            recorded.frames, recorded.sequence, recorded.noise, self._calibration.rig, self._water.index, loose,
            self._pipeline.limits, parallax,
        )  # fmt: skip

    @property
    def finished(self) -> bool:
        """``find_full`` was called, and nothing begun since."""
        return self._full is not None

    def hold(self) -> Sequence:
        """This sequence, for a second one to be merged with; a copy. Raises ValueError unless ``finished``."""
        return self._sequence({side: self._pipeline.decoded(side).copied() for side in SIDES})

    def merge_with(self, first: Sequence) -> Merged:
        """This sequence, the second of its scan, and the ``first`` as one; raises ValueError unless ``finished``."""
        return merge_pair(self._pipeline, first, self._sequence({}))

    def _sequence(self, maps: dict[str, DecodedMaps]) -> Sequence:
        if self._full is None:
            raise ValueError("the sequence has no full cloud yet; ask for it before another one is begun")
        bright = self._frames["left"][self._pipeline.sequence.bright]
        spoilt = self.moved and self._compensated is None
        return Sequence(
            self._pipeline.table.cloud(self._full), maps, bright, self._settings.exposure, self._settings.noise,
            moved=self.moved, spoilt=spoilt,
        )  # fmt: skip

    def _recorded(self) -> ScanImages:
        decoded = {side: self._pipeline.decoded(side) for side in SIDES}
        return ScanImages(self._pipeline.sequence, self._frames, decoded, self._settings)


def _compensation(tried: Attempt, frame_s: float) -> Verdict:
    """Errors are in units of those of a scan at rest."""
    if tried.motion is None:
        return Verdict("compensation", False, {}, tried.why)
    motion = tried.motion
    # Displacement from the first sine image to the last, over the time between.
    lasted_s = frame_s * (motion.frames[-1] - motion.frames[0])
    x, y, z = (motion.motion_mm[-1, :3] - motion.motion_mm[0, :3]) / lasted_s
    numbers: dict[str, float | None] = {
        "error_before": motion.error_before,
        "error_after": tried.error_after,
        "noise_factor": motion.noise_factor,
        "speed_x_mm_s": float(x),
        "speed_y_mm_s": float(y),
        "speed_z_mm_s": float(z),
        "reference_s": motion.reference_s,
    }
    return Verdict("compensation", tried.found is not None, numbers, tried.why)
