"""Owns what a calibration in water says to people and programs: a JSON-ready table, and a page that needs no other
file."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from typing import Any

from appliance.calibrate.water.drawings import cost_svg, residual_svg, seen_svg
from appliance.calibrate.water.method import WaterResult
from appliance.measure import PAGE_END, Calibration, Estimate, HousedCamera, drawing, page_head, rows, table

SCHEMA = 1
TITLE = "Calibration in water"
WHAT_IS_LEFT = ("residual_px", "systematic_px", "expected_length_percent", "expected_flat_percent")
EXPLAINED = (
    "The ray of a left pixel meets the artefact, and the point is seen by the right camera: by so much beside the "
    "matched "
    "pixel. Arrows are means over cells of the left image; random ones are noise, ordered ones are what the model "
    "cannot say."
)


def as_json(
    result: WaterResult, start: Calibration, about: Mapping[str, Any], left_out: Mapping[str, str]
) -> dict[str, Any]:
    """Return the report JSON-ready: residuals in px, lengths in mm, angles in degrees. ``left_out`` has a reason for
    each scan not used."""
    calibration = result.calibration
    return {
        "schema": SCHEMA,
        "title": TITLE,
        "about": {
            **about,
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
            name: {"calibration": one.hash, "residual_px": one.residual_px} for name, one in result.before.items()
        },
    }


def as_html(result: WaterResult, start: Calibration, about: Mapping[str, Any], left_out: Mapping[str, str]) -> str:
    """Return the page; drawings and pictures are in it, and nothing is loaded from elsewhere."""
    content = as_json(result, start, about, left_out)
    parts = [page_head(TITLE), table(content["about"])]
    parts += [f'<p class="no">{html.escape(warning)}</p>' for warning in result.warnings]
    parts += [f'<p class="no">Scan {html.escape(n)} not used: {html.escape(why)}.</p>' for n, why in left_out.items()]
    parts += ["<h2>Ports</h2>", table(content["ports"])]
    parts += [
        "<h2>What is left of the recordings</h2>",
        table({key: content[key] for key in WHAT_IS_LEFT}),
        f"<p>{EXPLAINED}</p>",
    ]
    if content["recordings"]:
        parts.append(rows(content["recordings"]))
    size = result.calibration.rig.left.width_px, result.calibration.rig.left.height_px
    for residuals in result.residuals:
        svg, unit_px = residual_svg(residuals, size)
        parts.append(drawing(f"{residuals.name}: an arrow as long as a cell is {unit_px:.3f} px", svg))
    if result.before:
        parts += ["<h2>The published models before the operator</h2>", table(content["before"])]
    if result.costs:
        parts += ["<h2>Convergence</h2>", drawing("cost before the first step and after each", cost_svg(result.costs))]
    if result.estimates:
        parts += [
            "<h2>What the recordings could see</h2>",
            drawing("uncertainty taken from the prior; red: stayed at its prior", seen_svg(result.estimates)),
            rows(content["estimates"]),
        ]
    return "\n".join([*parts, PAGE_END])


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
