"""Accuracy of the judgement of the water: attenuation and backscatter of random waters, against the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bench.result import Measurement
from bench.turbidity.scan import JudgedScan, expose, rig_in, set_water, take
from bench.turbidity.scenes import drawn_scene, drawn_water
from hw_sim.rendering.render import Renderer

WIDTH_PX = 400
"""Waters are judged at this size; the cost is measured at full size by itself."""
KNOWN_PER_M = 0.25
"""A standard error from which on an attenuation counts as known."""


def measure(scans: int, seed: int, say: Callable[[str, float], None]) -> tuple[list[Measurement], dict[str, Any]]:
    """Judge ``scans`` random scenes."""
    rows = []
    for k in range(scans):
        say("water", k / scans)
        rows.append(_row(np.random.default_rng([seed, k, 24]), seed * 1000 + k))
    z = np.array([row["z"] for row in rows if row["z"] is not None])
    precise = [row for row in rows if row["sigma_per_m"] is not None and row["sigma_per_m"] < KNOWN_PER_M]
    wrong = [abs(row["attenuation_per_m"] - row["true_attenuation_per_m"]) for row in precise]
    veil = np.array([row["veil_percent"] - row["true_veil_percent"] for row in rows])
    good = [row for row in rows if row["completeness_percent"] > 90.0]
    nan = float("nan")
    measured = [
        Measurement("veil, worst error, of the light", float(np.abs(veil).max()), "%", at_most=1.0),
        Measurement("veil, rms error, of the light", float(np.sqrt(np.mean(veil**2))), "%", at_most=0.3),
        Measurement("attenuation stated, of all scans", 100.0 * len(z) / scans, "%"),
        Measurement(
            "error of attenuation in its standard errors, rms", float(np.sqrt(np.mean(z**2))) if len(z) else nan, "",
            at_most=1.5,
        ),
        Measurement(
            "attenuation where known to 0.25 /m: median error", float(np.median(wrong)) if wrong else nan, "1/m"
        ),
        Measurement("dirty water said of good scans", float(sum(row["dirty"] for row in good)), "", at_most=0.0),
        Measurement("judging, median", float(np.median([row["cpu_ms"] for row in rows])), "ms CPU", at_most=15.0),
    ]  # fmt: skip
    return measured, {"rows": rows}


def _row(rng: np.random.Generator, rig_seed: int) -> dict[str, Any]:
    scene = drawn_scene(rng, drawn_water(rng))
    renderer = Renderer(rig_in(set_water(scene), "realistic", rig_seed, WIDTH_PX), scene)
    scan = take(renderer)
    water = scan.judgement
    true_per_m = scene.water.attenuation_per_m
    stated, sigma = water.attenuation_per_m, water.attenuation_sigma_per_m
    return {
        "object": scene.object,
        "texture": scene.texture,
        "true_attenuation_per_m": true_per_m,
        "true_backscatter_percent": 100.0 * scene.water.backscatter,
        "true_veil_percent": true_veil_percent(scan),
        "completeness_percent": 100.0 * scan.completeness,
        "exposure_ms": 1e3 * scan.shutter.exposure_s,
        "attenuation_per_m": stated,
        "sigma_per_m": sigma,
        "z": None if stated is None or sigma is None else (stated - true_per_m) / sigma,
        "veil_percent": water.veil_percent,
        "backscatter_percent": water.backscatter_percent,
        "masked_percent": water.masked_percent,
        "dirty": water.judgement.fault is not None,
        "cpu_ms": 1e3 * scan.judging_cpu_s,
    }


def true_veil_percent(scan: JudgedScan) -> float:
    """Return the backscatter as a share of the light on the left camera's pixels with coordinates.

    It is the bright frame minus the same frame of water without backscatter.
    """
    scene, sequence = scan.renderer.scene, scan.sequence
    bright, dark = (scan.frames["left"][k].astype(np.float64) for k in (sequence.bright, sequence.dark))
    clear_water = replace(scene.water, backscatter=0.0)
    clear = Renderer(scan.renderer.truth, replace(scene, water=clear_water))
    without = expose(clear, sequence, scan.shutter, sequence.bright)["left"][0]
    is_valid = scan.decoded & (bright < 255.0)
    return 100.0 * float((bright - without)[is_valid].sum() / (bright - dark)[is_valid].sum())
