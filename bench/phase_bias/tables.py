"""Measured tables: causes one at a time, periods, distances, borders of albedo, artefacts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from appliance.measure.accept.ball_bar import BallBar, find_ball_bar
from appliance.measure.accept.flatness import flatness
from appliance.measure.accept.frustum import Frustum, find_frustum
from appliance.measure.accept.plane import PlaneFit, fit_plane
from appliance.measure.light.response import Response
from bench.phase_bias.conditions import (
    EXPOSURE_S,
    FAR,
    MIDDLE,
    NEAR,
    TILTED,
    UM,
    WHOLE_PX,
    Pose,
    ReconstructedScan,
    read,
    response_seen,
    take,
)
from bench.phase_bias.paint import borders
from hw_sim.objects.shapes import BALL_RADIUS_MM, FRUSTUM_BASE_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Imaging, Scene

POSES = {"500 mm, facing": MIDDLE, "500 mm, turned by 35°": TILTED, "445 mm": NEAR, "560 mm": FAR}
"""By the distance from the front of the instrument, about."""
PURE = Imaging("linear", projector_defocus=False, camera_defocus=False)
REAL = Imaging("measured", projector_defocus=True, camera_defocus=True)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table."""

    table: str
    name: str
    values: dict[str, float]


def measured_response() -> tuple[Response, Row]:
    """Return the response as a user measures it: with noise and texture, from a plane with the longest fringes."""
    measured = response_seen(take(Scene(object="plane", pose=MIDDLE, imaging=REAL), 64))
    b = measured.fringe_harmonics
    values = {f"harmonic {k}, %": 100.0 * b[k] / b[1] for k in (2, 3, 4, 5)}
    return measured.response, Row(
        "response", "as recorded", {**values, "phase error, °": np.degrees(measured.phase_error_rad)}
    )


def after_compensation(response: Response) -> Row:
    """Measure the response again with patterns corrected for it."""
    scan = take(Scene(object="plane", pose=MIDDLE, imaging=REAL), 64, response=response)
    measured = response_seen(scan)
    b = measured.fringe_harmonics
    values = {f"harmonic {k}, %": 100.0 * b[k] / b[1] for k in (2, 3, 4, 5)}
    return Row("response", "drawn for it", {**values, "phase error, °": np.degrees(measured.phase_error_rad)})


def causes(response: Response) -> Iterator[Row]:
    """Yield the errors of planes by each cause alone, without noise and texture."""
    for place, pose in POSES.items():
        quiet = Scene(object="plane", pose=pose, texture="none", noise=False)
        for name, imaging, drawn in (
            ("none", PURE, None),
            ("response of the projector", replace(PURE, response="measured"), None),
            ("the same, patterns drawn for it", replace(PURE, response="measured"), response),
            ("projector out of focus", replace(PURE, projector_defocus=True), None),
            ("cameras out of focus", replace(PURE, camera_defocus=True), None),
            ("all three", REAL, None),
            ("all three, patterns drawn for it", REAL, response),
        ):
            scan = take(replace(quiet, imaging=imaging), 16, EXPOSURE_S[pose], drawn)
            r = read(scan)
            yield Row(
                "causes",
                f"{place}: {name}",
                {
                    "ripple of a coordinate, px": r.coordinate_ripple_px,
                    "left less right, px": r.difference_px,
                    "ripple of depth, µm": r.depth_ripple_um,
                    "smooth error, µm": r.smooth_um,
                    "rms, µm": r.rms_um,
                },
            )


def periods(response: Response) -> Iterator[Row]:
    """Yield the errors of every period at the working distance."""
    for period_px in (16, 32, 64):
        yield from both_ways("periods", f"{period_px} px", period_px, MIDDLE, response)


def distances(response: Response) -> Iterator[Row]:
    """Yield the errors of the shortest period at every pose."""
    for place, pose in POSES.items():
        yield from both_ways("distances", place, 16, pose, response)


def both_ways(table: str, name: str, period_px: int, pose: Pose, response: Response) -> Iterator[Row]:
    """Yield the errors without and with patterns corrected for the response."""
    for drawn, label in ((None, "codes are the sine"), (response, "light is the sine")):
        r = read(take(Scene(object="plane", pose=pose, imaging=REAL), period_px, EXPOSURE_S[pose], drawn))
        yield Row(
            table,
            f"{name}: {label}",
            {
                "ripple of a coordinate, px": r.coordinate_ripple_px,
                "ripple of depth, µm": r.depth_ripple_um,
                "smooth error, µm": r.smooth_um,
                "rms, µm": r.rms_um,
                "rms in sigmas": r.sigma_ratio,
                "modulation, DN": r.modulation_dn,
            },
        )


def paint(response: Response) -> Iterator[Row]:
    """Yield the errors at borders of albedo, without and with noise and correction; ``response`` is not used."""
    del response
    for name, texture, pose, noise, exposure_s in (
        ("checker", "checker", MIDDLE, False, 0.010),
        ("checker, turned by 35°", "checker", TILTED, False, 0.010),
        ("checker, noise", "checker", MIDDLE, True, 0.010),
        ("growth and paint", "strong", MIDDLE, False, 0.008),
        ("growth and paint, noise", "strong", MIDDLE, True, 0.008),
    ):
        scene = Scene(object="plane", pose=pose, texture=texture, noise=noise, imaging=replace(REAL, response="linear"))
        for corrected, label in ((False, ""), (True, ", corrected")):
            yield Row("paint", name + label, borders(take(scene, 16, exposure_s, corrected=corrected)))


def artefacts(response: Response) -> Iterator[Row]:
    """Yield errors of lengths and flatness of a ball bar, a plane and a frustum with the true calibration."""
    for name, imaging, noise, drawn in (
        ("nothing but pixels", PURE, False, None),
        ("response and defocus", REAL, False, None),
        ("response and defocus, light is the sine", REAL, False, response),
        ("noise too, codes are the sine", REAL, True, None),
        ("noise too, light is the sine", REAL, True, response),
    ):

        def cloud(
            artefact: str, imaging: Imaging = imaging, noise: bool = noise, drawn: Response | None = drawn
        ) -> ReconstructedScan:
            scene = Scene(object=artefact, texture="none", noise=noise, imaging=imaging)
            return take(scene, response=drawn, height_px=WHOLE_PX)

        scan = cloud("ballbar")
        bar, fit, frustum = (
            find_ball_bar(scan.cloud),
            fit_plane(cloud("plane").cloud),
            find_frustum(cloud("frustum").cloud),
        )
        if not isinstance(bar, BallBar) or not isinstance(fit, PlaneFit) or not isinstance(frustum, Frustum):
            raise RuntimeError(f"{name}: an artefact was not found")
        true_mm = scan.scan.renderer.truth.artefacts.ball_distance_mm
        flat = flatness(fit)
        balls = (bar.first, bar.second)
        edges = [
            (length / true - 1.0)
            for kind, true in (("top", FRUSTUM_TOP_MM), ("base", FRUSTUM_BASE_MM))
            for length in frustum.lengths_mm[kind]
        ]
        yield Row(
            "artefacts",
            name,
            {
                "E_L of the bar, %": 100.0 * (bar.length_mm / true_mm - 1.0),
                "radius of balls, µm": UM * float(np.mean([ball.sphere.radius_mm - BALL_RADIUS_MM for ball in balls])),
                "largest E_L of the frustum, %": 100.0 * max(edges, key=abs),
                "E_F,sys, %": 100.0 * flat.e_f_sys,
                "E_F, %": 100.0 * flat.e_f,
                "noise on the plane, µm": UM * (flat.noise_mm or float("nan")),
                "noise on balls, µm": UM * float(np.mean([np.std(ball.used.residual_mm) for ball in balls])),
            },
        )
