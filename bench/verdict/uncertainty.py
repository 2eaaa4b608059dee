"""Accuracy of sigma: errors of the points of random scans, in units of their sigma.

The error of a point is measured along the ray of its left pixel, as sigma is; where that exact ray meets no surface, it
is the distance to the true surface. The calibration is exact, lens field and wedge included, because sigma covers only
the errors of the scan. *All* is every point of the cloud. *Trimmed* leaves out the largest 0.3 %, as evaluations of
artefacts do; for a normal distribution the RMS is then 0.975.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.response import Response
from appliance.measure.points.pipeline import Cloud, Pipeline
from bench.result import Measurement
from bench.verdict.parts import Say
from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.optics.projector import response as light_of_codes
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import ray
from hw_sim.water.medium import Water
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, complete_calibration, left_to_rig

Array = NDArray[np.float64]

OBJECTS = ("plane", "ballbar", "frustum", "pipe", "shell", "stones")
TEXTURES = ("none", "slight", "strong", "checker")
SMALL_PX, STRIP_PX = (400, 300), (1600, 240)
STRIP_EVERY = 8
"""One of so many scans has the full horizontal resolution."""
TRIM = 0.003
BINS_UM = (5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0, 50.0, 65.0, 85.0, 120.0, 170.0, 250.0, 350.0, 500.0)
"""Of sigma, for the reliability curve."""
FEWEST = 500
"""Points of a class, or a bin, that make a figure."""


@dataclass(frozen=True, slots=True)
class Draw:
    """Settings of one random scan."""

    scene: Scene
    truth_seed: int
    size_px: tuple[int, int]
    period_px: int
    exposure_s: float
    gain_db: float
    patterns: str
    """Correction of the sine patterns: ``codes`` or ``light`` (a sine of codes, or of light)."""

    @property
    def classes(self) -> tuple[str, ...]:
        """The groups it belongs to."""
        small = "full resolution" if self.size_px == STRIP_PX else "400 x 300"
        return ("all", self.scene.object, f"paint {self.scene.texture}", f"{self.period_px} px", small, self.patterns)


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` static scans."""
    draws = [drawn(k, seed) for k in range(scans)]
    residuals, sigmas = [], []
    for k, draw in enumerate(draws):
        say(f"uncertainty: scan {k + 1} of {scans}", k / scans)
        error_mm, sigma_mm = errors(draw)
        residuals.append(error_mm / sigma_mm)
        sigmas.append(sigma_mm)
    return uncertainty_figures(draws, residuals, sigmas)


def uncertainty_figures(
    draws: Sequence[Draw], residuals: Sequence[Array], sigmas: Sequence[Array]
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return figures and raw data of scans whose points have ``residuals`` in units of ``sigmas``."""
    figures: list[Measurement] = []
    classes: dict[str, Any] = {}
    names = list(dict.fromkeys(name for draw in draws for name in draw.classes))
    for name in names:
        points = np.concatenate([r for draw, r in zip(draws, residuals, strict=True) if name in draw.classes])
        if len(points) < FEWEST:
            continue
        classes[name] = spread(points)
        figures.append(
            Measurement(f"error in sigmas, {name}: rms, trimmed", classes[name]["rms_trimmed"], "", 1.1, 0.9)
        )
        if name == "all":
            figures += [
                Measurement("error in sigmas: rms of all points", classes[name]["rms"], "", 1.1, 0.9),
                Measurement("within one sigma (normal: 0.683)", classes[name]["within_1"], "", 0.75, 0.62),
                Measurement("within two sigmas (normal: 0.954)", classes[name]["within_2"], "", 0.98, 0.93),
            ]
    each = [spread(r) for r in residuals]
    good = [0.9 <= scan_figures["rms_trimmed"] <= 1.1 for scan_figures in each if scan_figures["points"] >= FEWEST]
    figures.append(Measurement("scans within 10 % of 1", 100.0 * float(np.mean(good)) if good else math.nan, "%"))
    data = {
        "classes": classes,
        "reliability": reliability(np.concatenate(residuals), np.concatenate(sigmas)),
        "scans": [
            {
                "object": draw.scene.object, "pose": draw.scene.start_pose, "texture": draw.scene.texture,
                "truth_seed": draw.truth_seed, "width_px": draw.size_px[0], "period_px": draw.period_px,
                "exposure_s": draw.exposure_s, "gain_db": draw.gain_db, "ambient": draw.scene.ambient,
                "attenuation_per_m": draw.scene.water.attenuation_per_m,
                "backscatter": draw.scene.water.backscatter, "response": draw.scene.imaging.response,
                "patterns": draw.patterns, "sigma_um": float(1e3 * np.median(s)) if len(s) else None, **scan_figures,
            }
            for draw, scan_figures, s in zip(draws, each, sigmas, strict=True)
        ],
    }  # fmt: skip
    return figures, data


def drawn(number: int, seed: int) -> Draw:
    """Return the ``number``-th scan of a seed: objects in turns, all else at random."""
    rng = np.random.default_rng([seed, number, 5])
    name = OBJECTS[number % len(OBJECTS)]
    away = rng.normal(0.0, (12.0, 10.0, 15.0, 8.0, 8.0, 15.0))
    x, y, z, rx, ry, rz = (float(a + b) for a, b in zip(DEFAULT_POSE[name], away, strict=True))
    scene = Scene(
        object=name,
        pose=(x, y, z, rx, ry, rz),
        texture=str(rng.choice(TEXTURES)),
        water=Water(
            attenuation_per_m=float(rng.uniform(0.2, 1.2)),
            backscatter=float(10.0 ** rng.uniform(-2.5, -0.7)),
            blur_px_per_m=float(rng.uniform(0.1, 0.8)),
        ),
        ambient=float(10.0 ** rng.uniform(-2.0, -0.5)),
        imaging=Imaging(str(rng.choice(("measured", "linear")))),
    )
    return Draw(
        scene,
        int(rng.integers(1, 1_000_000)),
        STRIP_PX if number % STRIP_EVERY == STRIP_EVERY - 1 else SMALL_PX,
        int(rng.choice((16, 16, 32, 64))),
        float(rng.uniform(0.005, 0.012)),
        float(rng.choice((0.0, 0.0, 6.0))),
        str(rng.choice(("codes", "light"))),
    )


def errors(draw: Draw) -> tuple[Array, Array]:
    """Return errors along the ray and sigmas in mm, (n,) each, of all points of the cloud."""
    scan = render_scan(
        draw.scene, "realistic", draw.truth_seed, draw.size_px[0], draw.period_px, draw.exposure_s, draw.size_px[1],
        response_of(draw.scene.imaging.response) if draw.patterns == "light" else None, gain_db=draw.gain_db,
    )  # fmt: skip
    cloud = cloud_of(scan, draw)
    return along_the_ray(scan, cloud), cloud.sigma_mm.astype(np.float64)


def cloud_of(scan: RenderedScan, draw: Draw) -> Cloud:
    """Reconstruct a scan with the exact calibration, and the noise of data sheet and gain."""
    camera = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, draw.gain_db)
    calibration = complete_calibration(scan.renderer.truth)
    sequence = build_sequence(draw.period_px)
    with Pipeline(calibration, WATER, sequence, noise=StereoNoise(camera, camera)) as pipeline:
        for k in range(len(sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, k)
        pipeline.coarse()
        return pipeline.full()


def along_the_ray(scan: RenderedScan, cloud: Cloud, time_s: float = 0.0) -> Array:
    """Return the error of each point (n,) along its ray in mm at ``time_s``, positive if too far.

    Where its pixel sees no surface, it is the distance from the surface.
    """
    truth = scan.renderer.truth
    v, u = np.divmod(cloud.pixel.astype(np.int64), truth.left.width_px)
    points = left_to_rig(truth, cloud.points_mm)
    true = scan.renderer.view("left", time_s).points_rig_mm[v, u]
    _, direction = ray(truth, "left", np.stack([u, v], -1))
    along = np.sum((points - true) * direction, -1)
    nothing = ~np.isfinite(along)
    along[nothing] = scan.renderer.surface(time_s).distance_mm(points[nothing])
    return np.asarray(along)


def response_of(kind: str) -> Response:
    """Return the projector's response as measured without error."""
    codes = np.arange(8, 248)
    x = (codes - 127.5) / 119.5
    light = light_of_codes(kind)[codes].astype(np.float64)
    return Response(tuple(float(c) for c in np.polynomial.chebyshev.chebfit(x, light, 8)))


def spread(residuals: Array) -> dict[str, float]:
    """Return the distribution of residuals (n,) in sigmas."""
    if not len(residuals):
        return {"points": 0, "rms": math.nan, "rms_trimmed": math.nan, "within_1": math.nan, "within_2": math.nan}
    size = np.sort(np.abs(residuals))
    trimmed = size[: len(size) - math.ceil(TRIM * len(size))] if len(size) > 1 else size
    return {
        "points": len(size),
        "rms": float(np.sqrt(np.mean(size**2))),
        "rms_trimmed": float(np.sqrt(np.mean(trimmed**2))),
        "within_1": float(np.mean(size < 1.0)),
        "within_2": float(np.mean(size < 2.0)),
    }


def reliability(residuals: Array, sigmas_mm: Array) -> list[dict[str, float]]:
    """Return expected and actual RMS error, bin by bin of sigma."""
    rows = []
    for low, high in itertools.pairwise(BINS_UM):
        inside = (sigmas_mm >= 1e-3 * low) & (sigmas_mm < 1e-3 * high)
        if np.count_nonzero(inside) >= FEWEST:
            expected = 1e3 * float(np.sqrt(np.mean(sigmas_mm[inside] ** 2)))
            error = 1e3 * np.sort(np.abs(residuals[inside] * sigmas_mm[inside]))
            trimmed = error[: len(error) - math.ceil(TRIM * len(error))]
            rows.append(
                {
                    "points": int(np.count_nonzero(inside)),
                    "expected_um": expected,
                    "rms_um": float(np.sqrt(np.mean(error**2))),
                    "rms_trimmed_um": float(np.sqrt(np.mean(trimmed**2))),
                }
            )
    return rows
