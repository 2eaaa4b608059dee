"""One scan of the world ``outside``, from its frames to a row of figures: errors of points, verdicts, grade."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.fault import FaultCode
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import Direction, PatternSequence, build_sequence
from appliance.measure.light.water import Water
from appliance.measure.news import FullCloud
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdict import SPOILS_SCAN, Grade, grade
from bench.outside.kept import Row
from bench.outside.world import BLACK_DN, FRAME_S, STEPS, Frames, World
from bench.verdict.motion_truth import displaced, displacement
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import ray
from tests.support.truth import left_to_rig

FALSE_MM = 1.0
TRIM = 0.003
"""Share of the largest errors without which noise is computed, as for artefacts."""
STEP_MM, LEAST_COSINE = 0.01, 0.1
"""Step along the ray for the angle to the surface, and the least cosine of that angle that is used."""
FEWEST = 300
"""Least number of points for an error over sigma."""
SHEET_FULL_WELL_E, SHEET_READ_NOISE_E = 13_000.0, 20.0
"""Values of a rig file without the data sheet of the camera."""
Array = NDArray[np.float64]
SEQUENCE = build_sequence(16)


@dataclass(frozen=True, slots=True)
class ScanResult:
    """Result of a sequence in the instrument's procedure."""

    cloud: Cloud
    full: FullCloud
    grade: Grade
    codes: tuple[FaultCode, ...]
    """Faults except those that are only displayed."""
    cpu_s: float

    @property
    def accepted(self) -> bool:
        """True if no fault spoils the scan and it is worth keeping."""
        return self.grade is not Grade.BAD

    def numbers(self, name: str) -> dict[str, float | None]:
        """Return the numbers of the verdict ``name``; empty where it was not given."""
        return next((dict(j.verdict.numbers) for j in self.full.judgements if j.verdict.name == name), {})


def data_sheet(scene: Scene, gain_db: float) -> StereoNoise:
    """Return the noise by the data sheet of the scene's own cameras, as in a complete rig file."""
    traits = scene.outside.cameras
    if traits is None:
        noise = camera_noise(SHEET_FULL_WELL_E, SHEET_READ_NOISE_E, BLACK_DN, gain_db)
    else:
        noise = camera_noise(traits.full_well_e, traits.read_noise_e, traits.black_dn, gain_db)
    return StereoNoise(noise, noise)


def worked_through(
    frames: Frames, calibration: Calibration, water: Water, exposure: Exposure, noise: StereoNoise,
    sequence: PatternSequence = SEQUENCE,
) -> ScanResult:  # fmt: skip
    """Run a sequence through the instrument's procedure."""
    settings = AcquisitionSettings(exposure=exposure, frame_s=FRAME_S, noise=noise, steps=STEPS)
    with Pipeline(calibration, water, sequence, noise=noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        begun = time.process_time()
        full = processor.process(frames, settings)
        cpu_s = time.process_time() - begun
        cloud = pipeline.table.cloud(full.cloud)
    faults = tuple(judgement.fault for judgement in full.judgements if judgement.fault is not None)
    summary = full.cloud.summary
    spoilt = any(fault.code in SPOILS_SCAN for fault in faults)
    grade_of_scan = (
        Grade.BAD if spoilt else grade(summary.coverage_percent, summary.noise_mm, {fault.code for fault in faults})
    )
    codes = tuple(fault.code for fault in faults if fault.code is not FaultCode.COMPENSATED)
    return ScanResult(cloud, full, grade_of_scan, codes, cpu_s)


def moment_s(scanned: ScanResult, exposure: Exposure, sequence: PatternSequence = SEQUENCE) -> float:
    """Return the time after the first pulse whose surface the points should lie on."""
    reference_s = scanned.numbers("compensation").get("reference_s")
    moved = any(j.verdict.name == "compensation" and j.verdict.passed for j in scanned.full.judgements)
    if moved and reference_s is not None:
        return reference_s + 0.5e-6 * exposure.time_us
    # Depth follows from the fringes across the baseline.
    return float(np.mean(sequence.axis(Direction.X).sine)) * FRAME_S + 0.5e-6 * exposure.time_us


def row_of(world: World, scanned: ScanResult, exposure: Exposure) -> Row:
    """Return the verdicts of one scan and the errors of its points."""
    renderer, at_s = world.renderer(), moment_s(scanned, exposure)
    cloud, summary = scanned.cloud, scanned.full.cloud.summary
    view = renderer.view("left", at_s)
    visible = view.seen_by_all
    has_point = np.zeros(visible.size, bool)
    has_point[cloud.pixel] = True
    along_mm, away_mm = errors_mm(renderer, cloud, at_s)
    over = along_mm / cloud.sigma_mm.astype(np.float64)
    good = np.isfinite(over) & (np.abs(away_mm) <= FALSE_MM)
    scene, gaps = world.scene, scanned.full.cloud.gaps
    return {
        "seed": world.seed,
        "rig_seed": world.rig.seed,
        "families": list(world.families),
        "object": scene.object,
        "texture": scene.texture,
        "attenuation_per_m": scene.water.attenuation_per_m,
        "backscatter": scene.water.backscatter,
        "ambient": scene.ambient,
        "exposure": exposure.label,
        "grade": scanned.grade.value,
        "accepted": scanned.accepted,
        "faults": [code.value for code in scanned.codes],
        "compensated": any(j.verdict.name == "compensation" and j.verdict.passed for j in scanned.full.judgements),
        "texts": {j.verdict.name: j.verdict.text for j in scanned.full.judgements if j.fault is not None},
        "seen": int(np.count_nonzero(visible)),
        "complete_percent": 100.0 * float((has_point & visible.ravel()).sum()) / max(float(visible.sum()), 1.0),
        "points": len(cloud.pixel),
        "outliers": int(np.count_nonzero(np.abs(away_mm) > FALSE_MM)),
        "error_over_sigma": trimmed_rms(over[good]),
        "error_over_sigma_all": _rms(over[np.isfinite(over)]),
        "mean_over_sigma": float(np.mean(over[good])) if good.any() else None,
        "rms_um": _scaled(trimmed_rms(along_mm[good])),
        "sigma_um": 1000.0 * float(np.median(cloud.sigma_mm)) if len(cloud.pixel) else None,
        "noise_mm": summary.noise_mm,
        "coverage_percent": summary.coverage_percent,
        "cpu_s": scanned.cpu_s,
        "motion": scanned.numbers("motion"),
        "light": scanned.numbers("light"),
        "water": scanned.numbers("water"),
        "gaps": None if gaps is None else {item.name: _listed(getattr(gaps, item.name)) for item in fields(gaps)},
    }  # fmt: skip


def errors_mm(renderer: Renderer, cloud: Cloud, at_s: float) -> tuple[Array, Array]:
    """Return how far each point (n,) is off along the ray of its pixel, and how far from the true surface, mm, at ``at_s``.

    Of a scene that moves the rigid displacement of the whole cloud is taken away first: no cloud has another frame than its own.
    """
    truth = renderer.truth
    points = left_to_rig(truth, cloud.points_mm)
    surface = renderer.surface(at_s)
    if renderer.scene.moves:
        points = displaced(points, *displacement(surface, points))
    away = surface.distance_mm(points)
    v, u = np.divmod(cloud.pixel.astype(np.int64), truth.left.width_px)
    _, direction = ray(truth, "left", np.stack([u, v], -1))
    if renderer.scene.moves:
        # Where the object slides along itself the displacement is anybody's, and the pixel's own point of the surface no measure: along
        # the ray it is as far as the surface is away, over the cosine between both.
        cosine = (surface.distance_mm(points + STEP_MM * direction) - away) / STEP_MM
        return np.asarray(away / np.where(np.abs(cosine) >= LEAST_COSINE, cosine, 1.0)), away
    along = np.sum((points - renderer.view("left", at_s).points_rig_mm[v, u]) * direction, -1)
    nothing = ~np.isfinite(along)
    along[nothing] = away[nothing]
    return np.asarray(along), away


def trimmed_rms(values: Array) -> float | None:
    """Return the root mean square without the largest ``TRIM``; ``None`` for too few."""
    if len(values) < FEWEST:
        return None
    size = np.sort(np.abs(values))
    return _rms(size[: len(size) - math.ceil(TRIM * len(size))])


def still(world: World) -> World:
    """Return the same scene with the instrument at rest."""
    outside = replace(world.scene.outside, hands=None, soft=None)
    families = tuple(f for f in world.families if f not in ("hands", "soft"))
    return replace(world, families=families, scene=replace(world.scene, outside=outside))


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _scaled(mm: float | None) -> float | None:
    return None if mm is None else 1000.0 * mm


def _listed(value: Any) -> Any:
    """Return an array as lists, any other value as it is."""
    return value.tolist() if isinstance(value, np.ndarray) else value
