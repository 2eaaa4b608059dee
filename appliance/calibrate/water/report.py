"""Report of a water calibration: a JSON-ready table, and a page that needs no other file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from appliance.base import Page, bars, draw_curves
from appliance.calibrate.water.artefact import Residuals
from appliance.calibrate.water.judgement import Estimate
from appliance.calibrate.water.method import WaterResult
from appliance.measure import Calibration, HousedCamera

WIDTH = 480
CELLS = (20, 15)
FEWEST_IN_CELL = 3
ARROW = 0.9
"""Length of an arrow at the 95th percentile, in cells."""


SCHEMA = 1
TITLE = "Calibration in water"
WHAT_IS_LEFT = ("residual_px", "systematic_px", "expected_length_percent", "expected_flat_percent")
EXPLAINED = (
    "Reprojection errors in the right image: the left pixel's ray meets the artefact, and that point is "
    "projected into the right camera. Arrows are means over cells of the left image; random arrows are "
    "noise, ordered ones are errors of the model."
)


def as_json(
    result: WaterResult, start: Calibration, facts: Mapping[str, Any], left_out: Mapping[str, str]
) -> dict[str, Any]:
    """Return the report JSON-ready: residuals in px, lengths in mm, angles in degrees.

    ``left_out`` has a reason for each scan that was not used.
    """
    calibration = result.calibration
    return {
        "schema": SCHEMA,
        "title": TITLE,
        "about": {
            **facts,
            "method": result.method.value,
            "calibration": calibration.hash,
            "started_from": start.hash,
            "started_from_method": start.method,
            "water_temperature_c": calibration.water.temperature_c,
            "water_salinity_psu": calibration.water.salinity_psu,
            "water_index": calibration.water.index,
        },
        "warnings": list(result.warnings),
        "left_out": dict(left_out),
        "residual_px": calibration.residual_px,
        "systematic_px": result.systematic_px,
        "expected_length_percent": None if result.expected is None else result.expected.length_percent,
        "expected_flat_percent": None if result.expected is None else result.expected.flat_percent,
        "recordings": [{"name": r.name, "points": len(r.left_px), "residual_px": r.rms_px} for r in result.residuals],
        "ports": {
            side: {"before": _port(before), "after": _port(after)}
            for side, before, after in (
                ("left", start.rig.left, calibration.rig.left),
                ("right", start.rig.right, calibration.rig.right),
            )
        },
        "estimates": [_estimate(e) for e in result.estimates],
        "unobserved": list(result.unobserved),
        "costs": list(result.costs),
        "before": {
            name: {"calibration": model.hash, "residual_px": model.residual_px} for name, model in result.before.items()
        },
    }


def as_html(result: WaterResult, start: Calibration, facts: Mapping[str, Any], left_out: Mapping[str, str]) -> str:
    """Return the report as one HTML page that contains its drawings and loads no other file."""
    content = as_json(result, start, facts, left_out)
    page = Page(TITLE, facts=content["about"])
    for warning in result.warnings:
        page.problem(warning)
    for name, reason in left_out.items():
        page.problem(f"Scan {name} not used: {reason}.")
    page.heading("Ports")
    page.facts(content["ports"])
    page.heading("Residuals of the recordings")
    page.facts({key: content[key] for key in WHAT_IS_LEFT})
    page.note(EXPLAINED)
    if content["recordings"]:
        page.rows(content["recordings"])
    size = result.calibration.rig.left.width_px, result.calibration.rig.left.height_px
    for residuals in result.residuals:
        svg, unit_px = residual_svg(residuals, size)
        page.figure(f"{residuals.name}: an arrow of one cell is {unit_px:.3f} px", svg)
    if result.before:
        page.heading("The published models before the correction")
        page.facts(content["before"])
    if result.costs:
        page.heading("Convergence")
        falling = np.arange(len(result.costs), dtype=np.float64), np.log10(np.maximum(result.costs, 1e-300))
        page.figure(
            "cost before the first step and after each",
            draw_curves({"cost": falling}, "step", "cost, power of ten"),
        )
    if result.estimates:
        page.heading("Observability of the parameters")
        gains = {item.name: float(np.clip(1.0 - item.sd / item.prior_sd, 0.0, 1.0)) for item in result.estimates}
        at_prior = {item.name for item in result.estimates if item.at_prior}
        page.figure(
            "standard deviation over that of the prior; red: determined by the prior alone", bars(gains, at_prior)
        )
        page.rows(content["estimates"])
    return page.as_html()


def residual_svg(residuals: Residuals, size_px: tuple[int, int]) -> tuple[str, float]:
    """Return the mean residuals over cells of the left image as arrows, and the px of an arrow one cell long."""
    width_px, height_px = size_px
    cell = width_px / CELLS[0]
    column = np.clip(residuals.left_px[:, 0] / width_px * CELLS[0], 0, CELLS[0] - 1).astype(np.intp)
    row = np.clip(residuals.left_px[:, 1] / height_px * CELLS[1], 0, CELLS[1] - 1).astype(np.intp)
    cells = row * CELLS[0] + column
    count = np.bincount(cells, minlength=CELLS[0] * CELLS[1])
    total = np.stack([np.bincount(cells, m, minlength=count.size) for m in residuals.residual_px.T], -1)
    mean = total / np.maximum(count, 1)[:, None]
    shown = np.flatnonzero(count >= FEWEST_IN_CELL)
    longest = float(np.percentile(np.linalg.norm(mean[shown], axis=1), 95)) if shown.size else 0.0
    scale = ARROW * cell / max(longest, 1e-9)
    lines = []
    for k in shown:
        x, y = (k % CELLS[0] + 0.5) * cell, (k // CELLS[0] + 0.5) * height_px / CELLS[1]
        dx, dy = mean[k] * scale
        lines.append(
            f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{0.06 * cell:.0f}"/>'
            f'<line x1="{x:.0f}" y1="{y:.0f}" x2="{x + dx:.0f}" y2="{y + dy:.0f}"/>'
        )
    style = f'stroke="#222" stroke-width="{0.05 * cell:.1f}" fill="#222"'
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" viewBox="0 0 {width_px} {height_px}">'
        f"<g {style}>{''.join(lines)}</g></svg>"
    )
    return svg, longest / ARROW


def _port(camera: HousedCamera) -> dict[str, float]:
    x, y, z = camera.port.normal
    return {
        "distance_mm": camera.port.distance_mm,
        "tilt_x_deg": math.degrees(math.atan2(x, z)),
        "tilt_y_deg": math.degrees(math.atan2(y, z)),
    }


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "name": estimate.name,
        "change": estimate.change,
        "prior_sd": estimate.prior_sd,
        "sd": estimate.sd,
        "at_prior": estimate.at_prior,
    }
