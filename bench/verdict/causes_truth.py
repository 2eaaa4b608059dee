"""True quality of a scan, and the factors that truly spoil it, found by removing them one by one.

Quality is measured against the true surface, without any judge of the product: the number of points within 1 mm of it,
and their error (after the rigid displacement that moving hands leave). Removal of a factor *mends* a scan if it gives
more points, by a tenth of the base's points, or points with 3 % less error. A factor is a true cause if its removal
mends the scan. If no single removal does, because two factors each spoil the scan, every factor is a true cause that
spoils the base alone.

A factor is also a true cause if it alone leaves fewer points than a usable scan has (``USABLE_POINTS``): no scan is
usable while it is present, so the diver must act on it. An example: hands of 60 mm/s in front of images of which nine
tenths are saturated. At rest the scan is bad, well exposed it is bad, and both causes are right. The figure that counts
mending alone is measured beside it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import appliance
from appliance.instrument.machine.alerts import alert_of
from appliance.measure.calibration.file import Calibration
from appliance.measure.fault import FaultCode
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import Direction
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdict import SPOILS_SCAN, Grade, grade
from bench.outside.stated import StatedCalibration, stated_truth
from bench.outside.world import TRIGGER_DELAY_US
from bench.verdict.causes_frames import TRUTH_SET, frames_of
from bench.verdict.causes_scenes import NONE, STEPS, WIDTH_PX, Base, FactorLevels, exposure_of, scene_of
from bench.verdict.light_scenes import noise_at
from bench.verdict.motion_truth import FALSE_MM, errors_mm, rms_mm
from bench.verdict.outside import noise_of, put_outside, suited_s
from bench.verdict.worlds import ORDINARY
from hw_sim.rendering.render import LightSlice
from tests.support.rendered import RenderedScan, pictures
from tests.support.truth import WATER, true_calibration

MORE_POINTS, LESS_ERROR = 0.10, 1.03
LEAST_POINTS = 0.10
"""Least share of the base's points for a valid error."""
USABLE_POINTS = 0.25
"""Least share of the base's points in a usable scan: a quarter of the illuminated pixels, as in its grade."""
AIM_DN, BRIGHTEST = 225.0, 99.5
"""Where a suitable exposure puts that percentile of the bright frame."""
FACTOR_OF = {
    FaultCode.MOVED: "hands",
    FaultCode.WATER_DIRTY: "water",
    FaultCode.TOO_DARK: "light",
    FaultCode.TOO_BRIGHT: "light",
    FaultCode.AMBIENT: "light",
    FaultCode.LIGHT_FLICKERS: "light",
    FaultCode.SCAN_NEAR: "distance",
    FaultCode.SCAN_FAR: "distance",
    FaultCode.NOTHING_SEEN: "distance",
}
"""The factor that a reason blames; a reason that is none of these is never a true one."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One scan as judged by the product, and in truth."""

    grade: Grade
    reasons: tuple[FaultCode, ...]
    """Causes in the order of the screen, without those that are only displayed."""
    coverage_percent: float | None
    good: int
    """Points within a millimetre of the surface."""
    error_mm: float | None
    """RMS error of these points; ``None`` for too few."""
    texts: dict[str, str]
    numbers: dict[str, dict[str, float | None]]


def judge_scan(scan: RenderedScan, exposure: Exposure, stated: StatedCalibration | None = None) -> Outcome:
    """Run a scan through the instrument's procedure with the true calibration, and compare its points with the truth.

    ``stated``: the calibration that states a true rig of the world ``outside``; ``None`` for the ordinary world.
    """
    settings, calibration, water = _taken(scan, exposure, stated)
    with Pipeline(calibration, water, scan.sequence, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = processor.process(scan.frames, settings)
        cloud, judgements = pipeline.table.cloud(full.cloud), full.judgements
    faults = tuple(judgement.fault for judgement in judgements if judgement.fault is not None)
    summary = cloud.summary
    # The diver reads only faults that spoil a scan entirely, if there are any.
    spoilt = [fault for fault in faults if fault.code in SPOILS_SCAN]
    ranked = spoilt or sorted(faults, key=lambda fault: -alert_of(fault).severity)
    good, error_mm = _worth(scan, cloud)
    return Outcome(
        Grade.BAD if spoilt else grade(summary.coverage_percent, summary.noise_mm, {fault.code for fault in faults}),
        tuple(fault.code for fault in ranked if fault.code is not FaultCode.COMPENSATED),
        summary.coverage_percent, good, error_mm,
        {judgement.verdict.name: judgement.verdict.text for judgement in judgements},
        {judgement.verdict.name: dict(judgement.verdict.numbers) for judgement in judgements},
    )  # fmt: skip


def _taken(
    scan: RenderedScan, exposure: Exposure, stated: StatedCalibration | None
) -> tuple[AcquisitionSettings, Calibration, Water]:
    """Return the settings of a scan, and the calibration and water that state the truth."""
    if stated is None:
        calibration, noise, water = true_calibration(scan.renderer.truth), noise_at(exposure), WATER
    else:
        calibration, water = stated.calibration, stated.water
        noise = noise_of(scan.renderer.scene, exposure.gain_db)
    return AcquisitionSettings(exposure=exposure, noise=noise, steps=STEPS), calibration, water


def written(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome JSON-ready."""
    content = asdict(outcome)
    content["grade"], content["reasons"] = outcome.grade.value, [code.value for code in outcome.reasons]
    return content


def read_outcome(content: dict[str, Any]) -> Outcome:
    """Return the outcome that ``written`` stored."""
    reasons = tuple(FaultCode(code) for code in content["reasons"])
    return Outcome(**{**content, "grade": Grade(content["grade"]), "reasons": reasons})


@cache
def sources_digest() -> str:
    """Return a hash of the product's sources, which separates results of different versions."""
    hasher = hashlib.sha256()
    for path in sorted(Path(appliance.__file__).parent.rglob("*.py")):
        hasher.update(path.read_bytes())
    return hasher.hexdigest()


def _worth(scan: RenderedScan, cloud: Cloud) -> tuple[int, float | None]:
    if len(cloud.pixel) < 100:
        return 0, None
    # Depth follows from the fringes across the baseline: a moving scan's points belong to the middle of these.
    time_s = float(np.mean(scan.sequence.axis(Direction.X).sine)) * scan.frame_s
    errors, _ = errors_mm(scan.renderer, cloud, time_s)
    good = int(np.count_nonzero(np.abs(errors) < FALSE_MM))
    return good, rms_mm(errors) if good else None


class Truth:
    """The outcomes of one base's scenes, each worked out once."""

    def __init__(self, base: Base, keep: Path | None, world: str = ORDINARY) -> None:
        self._base, self._keep, self._world = base, keep, world
        self._stated: StatedCalibration | None = None
        self._usual = self._usual_exposure()
        self._known: dict[tuple[FactorLevels, Exposure], Outcome] = {}

    def outcome(self, levels: FactorLevels, exposure: Exposure | None = None) -> Outcome:
        """Return the outcome of a scene, at its own or another exposure."""
        chosen = exposure or self._exposure_of(levels)
        if (levels, chosen) not in self._known:
            self._known[levels, chosen] = self._kept(levels, chosen)
        return self._known[levels, chosen]

    def scan_inputs(self, levels: FactorLevels) -> tuple[RenderedScan, AcquisitionSettings, Calibration, Water]:
        """Return the exposed scan of a scene, its settings, and the calibration and water that state the truth."""
        exposure = self._exposure_of(levels)
        scan = frames_of(self._base, levels, self._keep, exposure, self._world)
        return scan, *_taken(scan, exposure, self._stated)

    def _usual_exposure(self) -> Exposure | None:
        """Return the exposure that suits the base in the world ``outside``, where whites, sensors and spots of light
        differ."""
        if self._world == ORDINARY:
            return None
        scene = scene_of(self._base, FactorLevels())
        world = put_outside(scene, self._base.rig_seed, TRUTH_SET, width_px=WIDTH_PX, hands=False)
        # Every scene of a base is before the same rig, in water of one temperature.
        self._stated = stated_truth(world.rig, world.scene)
        return Exposure(round(1e6 * suited_s(world.renderer(), 0.0, 1.0)))

    def _exposure_of(self, levels: FactorLevels) -> Exposure:
        """Return the exposure of a scene; too dark and too bright are factors on the suitable one of the base."""
        ordinary = exposure_of(levels)
        if self._usual is None or levels.light == "over":
            return ordinary
        usual_us = exposure_of(FactorLevels()).time_us
        return Exposure(max(round(self._usual.time_us * ordinary.time_us / usual_us), 20), ordinary.gain_db)

    def _kept(self, levels: FactorLevels, exposure: Exposure) -> Outcome:
        """Return the stored outcome if this version of the product has judged the scene, else judge it."""
        if self._keep is None:
            return judge_scan(frames_of(self._base, levels, None, exposure, self._world), exposure, self._stated)
        where = () if self._world == ORDINARY else (self._world, "stated")
        what = repr((self._base, levels, exposure, sources_digest(), *where))
        path = self._keep / f"causes-outcome-{hashlib.sha256(what.encode()).hexdigest()[:20]}.json"
        if path.exists():
            return read_outcome(json.loads(path.read_text(encoding="utf-8")))
        outcome = judge_scan(frames_of(self._base, levels, self._keep, exposure, self._world), exposure, self._stated)
        draft = path.with_name(f".{path.name}")
        draft.write_text(json.dumps(written(outcome)) + "\n", encoding="utf-8")
        draft.replace(path)
        return outcome

    def causes(self, levels: FactorLevels, blamed: str | None) -> set[str]:
        """Return the factors that truly spoil a scene.

        Light, where it is not a changed factor, is tested only if it is ``blamed``: then with the suitable exposure.
        """
        return self.mending(levels, blamed) | self._fatal(levels)

    def mending(self, levels: FactorLevels, blamed: str | None) -> set[str]:
        """Return the factors each of which improves the scan if removed alone; without any, those that alone spoil the
        base.

        ``blamed`` as in ``causes``.
        """
        present_outcome = self.outcome(levels)
        true = {
            factor for factor in levels.present if self._mends(present_outcome, self.outcome(levels.without(factor)))
        }
        if blamed == "light" and levels.light == NONE:
            suited = self._suited(levels)
            if suited is not None and self._mends(present_outcome, self.outcome(levels, suited)):
                true.add("light")
        if true:
            return true
        clean = self.outcome(FactorLevels())
        return {factor for factor in levels.present if self._mends(self.outcome(levels.alone(factor)), clean)}

    def _fatal(self, levels: FactorLevels) -> set[str]:
        """Return the factors each of which alone makes every scan unusable."""
        least_good = USABLE_POINTS * self.outcome(FactorLevels()).good
        return {factor for factor in levels.present if self.outcome(levels.alone(factor)).good < least_good}

    def _mends(self, before: Outcome, after: Outcome) -> bool:
        base = self.outcome(FactorLevels()).good
        if after.good - before.good >= MORE_POINTS * base:
            return True
        enough = min(before.good, after.good) >= LEAST_POINTS * base
        if not enough or before.error_mm is None or after.error_mm is None:
            return False
        return before.error_mm >= LESS_ERROR * after.error_mm

    def _suited(self, levels: FactorLevels) -> Exposure | None:
        """Return the step of the exposure that uses the scale without saturation; ``None`` if the present one does."""
        present = self._exposure_of(levels)
        scan = frames_of(self._base, levels, self._keep, present, self._world)
        white = pictures(scan.sequence)[scan.sequence.bright]

        def brightest(step: Exposure) -> float:
            light = [LightSlice(white, step.time_us / 1e6, TRIGGER_DELAY_US / 1e6)]
            shot = scan.renderer.expose("left", light, 0.0, step.time_us / 1e6, step.gain_db, (False, False), 0)
            return float(np.percentile(shot, BRIGHTEST))

        fitting = [step for step in STEPS if brightest(step) <= AIM_DN]
        chosen = fitting[-1] if fitting else STEPS[0]
        return None if chosen == present else chosen
