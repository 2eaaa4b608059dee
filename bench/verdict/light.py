"""Figures of the judge of light: proposed exposures, and reported flicker by its added noise.

The true harm of a flicker comes from the same scene rendered without noise, with and without the change of light: the
difference of the phases, over their usual noise, is the value that the judge should find.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import Direction
from appliance.measure.light.sides import SIDES
from appliance.measure.points.merge import merge
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.verdicts.light.changes import HARMFUL_RIPPLE
from appliance.measure.verdicts.light.judge import MAX_HARMED, judge_light
from bench.result import Measurement
from bench.verdict.light_scenes import (
    HEIGHT_PX,
    SEQUENCE,
    STEPS,
    WIDTH_PX,
    Case,
    draw_case,
    draw_daylight,
    noise_at,
    photograph,
    recorded,
    renderer_of,
    scan_of,
    without,
)
from bench.verdict.parts import Say
from tests.support.rendered import judge
from tests.support.truth import WATER, true_calibration

MOST_PROPOSALS = 4
ROUNDING_DN2 = 1.0 / 12.0
CLEARLY_HARMED, CLEARLY_NOT = (1.3, 0.20), (0.8, 0.05)
"""Flicker that must be reported, and that must not: multiple of the harmful ripple, and share of illuminated pixels
with more. Between them either result is right, and is counted."""


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` random scenes for exposure and steady light, and as many with changing light."""
    exposures = []
    for k in range(scans):
        say("exposure", k / (2 * scans))
        exposures.append(_expose(np.random.default_rng([seed, 31, k])))
    changes = []
    for k in range(scans):
        say("changing light", (scans + k) / (2 * scans))
        changes.append(_change(np.random.default_rng([seed, 32, k])))
    pairs = []
    for k in range(max(1, scans // 8)):
        say("two exposures", k / max(1, scans // 8))
        pairs.append(_pair(np.random.default_rng([seed, 33, k])))
    gained = [pair["together"][0] - max(pair["short"][0], pair["long"][0]) for pair in pairs]
    worse = [pair["together"][1] / max(pair["short"][1], pair["long"][1]) for pair in pairs]
    with_points = [row for row in exposures if row["top"] is not None]
    wrong = [row for row in changes if row["verdict"] != "either" and row["told"] != (row["verdict"] == "harm")]
    harm = [row for row in changes if row["verdict"] == "harm"]
    free = [row for row in changes if row["verdict"] == "none"]
    ripples = [row["ripple_told"] / row["ripple"] for row in changes if row["ripple"] > 0.5 and row["ripple_told"]]
    right = 100.0 * float(np.mean([row["right"] for row in with_points])) if with_points else float("nan")
    missed = 100.0 * float(np.mean([not row["told"] for row in harm])) if harm else float("nan")
    false = 100.0 * float(np.mean([row["told"] for row in free])) if free else float("nan")
    return [
        Measurement(
            "exposures right after at most one proposal", right, "%", at_least=95.0, key="exposure_right_percent"
        ),
        Measurement(
            "scenes where a proposal led to another", float(sum(row["proposals"] > 1 for row in exposures)), "scenes",
            at_most=0.0, key="exposure_oscillations",
        ),
        Measurement(
            "flicker reported of steady light", float(sum(row["flickers"] for row in exposures)), "scans", at_most=0.0,
            key="flicker_false_steady",
        ),
        Measurement("flicker reported where it does no harm", false, "%", at_most=2.0, key="flicker_false_percent")
        if free else Measurement("flicker reported where it does no harm", float("nan"), "%", why="none was drawn"),
        Measurement("harmful flicker missed", missed, "%", at_most=2.0, key="flicker_missed_percent")
        if harm else Measurement("harmful flicker missed", float("nan"), "%", why="none was drawn"),
        Measurement("ripple as stated over the true one (median)", float(np.median(ripples)), "", 1.25, 0.8)
        if ripples
        else Measurement("ripple as stated over the true one (median)", float("nan"), "", why="none was drawn"),
        Measurement("points gained by a second exposure (least)", min(gained), "%", at_least=-0.5),
        Measurement("their error over the worse single one (most)", max(worse), "", at_most=1.05),
    ], {"exposures": exposures, "changes": changes, "wrong": wrong, "pairs": pairs}  # fmt: skip


def _expose(rng: np.random.Generator) -> dict[str, Any]:
    """Follow the proposals from a random exposure; right if the brightest surfaces use the scale without saturation."""
    case = draw_case(rng)
    renderer = renderer_of(case)
    # More gain is set only where an object was too dark for any exposure; from there, a bright one may take two.
    usual = [step for step in STEPS if step.gain_db == 0.0]
    exposure = usual[rng.integers(0, len(usual))]
    labels, flickers = [exposure.label], 0
    while True:
        frames = photograph(renderer, exposure, int(rng.integers(1 << 30)))
        judged = judge_light(recorded(frames, exposure), exposure, STEPS)
        flickers += judged.fault is not None and judged.fault.code is FaultCode.LIGHT_FLICKERS
        if judged.proposal is None or len(labels) > MOST_PROPOSALS:
            break
        exposure = judged.proposal
        labels.append(exposure.label)
    top, saturated = _level(frames)
    enough = top >= 0.5 or exposure == STEPS[-1]
    is_unsaturated = saturated <= 0.02 or exposure == STEPS[0]
    return {
        "case": case.name, "way": labels, "proposals": len(labels) - 1, "flickers": int(flickers), "top": top,
        "saturated": saturated, "right": bool(enough and is_unsaturated and len(labels) <= 2),
        "fault": None if judged.fault is None else judged.fault.code.value,
    }  # fmt: skip


def _pair(rng: np.random.Generator) -> dict[str, Any]:
    """Return completeness in percent and RMS error in mm of 2.5 ms, of 16 ms, and of both as one."""
    case = draw_case(rng)
    renderer = renderer_of(replace(case, scene=replace(case.scene, texture="checker")))
    calibration, clouds = true_calibration(renderer.truth), {}
    exposures = (Exposure(2_500), Exposure(16_000))
    shots = [photograph(renderer, exposure, int(rng.integers(1 << 30))) for exposure in exposures]
    for name, stacks in (("short", shots[:1]), ("long", shots[1:]), ("together", shots)):
        variance_px2: dict[str, NDArray[np.float32]] = {}
        with Pipeline(calibration, WATER, SEQUENCE, noise=noise_at(exposures[0])) as pipeline:
            for side in SIDES:
                decoders = [pipeline.decoded(side), CameraDecoder(SEQUENCE, WIDTH_PX, HEIGHT_PX)]
                for k in range(len(SEQUENCE)):
                    pipeline.push(side, stacks[0][side], k)
                    decoders[1].push(stacks[-1][side], k)
                if len(stacks) > 1:
                    camera = noise_at(exposures[0]).left
                    variance_px2[side] = np.empty(decoders[0].mask.shape, np.float32)
                    merge(decoders[0], decoders[1], (camera, camera), SEQUENCE.period_px, variance_px2[side])
            pipeline.coarse()
            cloud = pipeline.table.cloud(pipeline.find_changed(variance_px2=variance_px2 or None))
            accuracy = judge(scan_of(renderer, stacks[0]), cloud)
        clouds[name] = (accuracy.completeness_percent, accuracy.rms_mm)
    return {"case": case.name, **clouds}


def _level(frames: dict[str, NDArray[np.uint8]]) -> tuple[float, float]:
    """Return the share of the scale that the brightest 0.3 % use, and the saturated share of illuminated pixels.

    Both are of the brighter camera.
    """
    tops, shares = [], []
    for stack in frames.values():
        bright, dark = stack[SEQUENCE.bright], stack[SEQUENCE.dark]
        illuminated = (bright.astype(int) - dark >= 8) | (bright == 255)
        tops.append(float(np.quantile(np.where(illuminated, bright, 0), 0.997)) / 255.0)
        shares.append(float(np.mean(bright[illuminated] == 255)) if illuminated.any() else 0.0)
    return max(tops), max(shares)


def _change(rng: np.random.Generator) -> dict[str, Any]:
    """Judge one scan in changing light, and measure the true effect of the change."""
    case = draw_case(rng)
    daylight, ambient, name = draw_daylight(rng)
    scene = replace(case.scene, ambient=ambient, daylight=daylight)
    renderer = renderer_of(Case(scene, case.rig_seed, case.name))
    exposure = Exposure(8_000)
    judged = judge_light(
        recorded(photograph(renderer, exposure, int(rng.integers(1 << 30))), exposure), exposure, STEPS
    )
    renderer.scene = without(scene, noise=False)
    changing = photograph(renderer, exposure, 0, ("left",))["left"]
    renderer.scene = _still(scene)
    steady = photograph(renderer, exposure, 0, ("left",))["left"]
    over_noise, is_valid = _ripple(changing, steady, exposure)
    harmed = {factor: float(np.mean(over_noise[is_valid] > factor * HARMFUL_RIPPLE)) for factor in (0.8, 1.0, 1.3)}
    verdict = "either"
    if harmed[CLEARLY_HARMED[0]] > CLEARLY_HARMED[1]:
        verdict = "harm"
    elif harmed[CLEARLY_NOT[0]] < CLEARLY_NOT[1]:
        verdict = "none"
    numbers = judged.verdict.numbers
    return {
        "case": case.name, "light": name, "verdict": verdict, "harmed": harmed[1.0], "limit": MAX_HARMED,
        "told": judged.fault is not None and judged.fault.code is FaultCode.LIGHT_FLICKERS,
        "fault": None if judged.fault is None else judged.fault.code.value,
        "harmed_told": [numbers["left_flicker_harmed_percent"], numbers["right_flicker_harmed_percent"]],
        "ripple": float(np.sqrt(np.median(over_noise[is_valid] ** 2))),
        "ripple_told": numbers["left_flicker_over_noise"],
    }  # fmt: skip


def _still(scene: Any) -> Any:
    """Return the scene with the same light at rest, without noise."""
    daylight = replace(scene.daylight, flicker_depth=0.0, caustics=0.0, torch_velocity_mm_s=(0.0, 0.0, 0.0))
    return replace(scene, noise=False, daylight=daylight)


def _ripple(
    changing: NDArray[np.uint8], steady: NDArray[np.uint8], exposure: Exposure
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the local RMS phase error over its noise (h, w), of both directions, and where it is valid."""
    noise = noise_at(exposure).left
    bright, dark = steady[SEQUENCE.bright].astype(float), steady[SEQUENCE.dark].astype(float)
    is_valid = bright - dark >= 12.0
    is_valid &= (changing < 248).all(axis=0) & (steady < 248).all(axis=0)
    total = np.zeros(is_valid.shape)
    weight = np.full(is_valid.shape, 1e-9)
    for direction in Direction:
        numbers = list(SEQUENCE.axis(direction).sine)
        i, j = changing[numbers].astype(float), steady[numbers].astype(float)
        a, b = i[0] - i[2] + 1j * (i[3] - i[1]), j[0] - j[2] + 1j * (j[3] - j[1])
        amplitude = 0.5 * np.abs(b)
        bias2 = np.angle(a * np.conj(b)) ** 2 - ROUNDING_DN2 / np.maximum(amplitude, 1.0) ** 2
        sigma2 = (noise.read_dn**2 + noise.dn_per_e * np.maximum(j.mean(axis=0) - noise.black_dn, 0.0)) / 2.0
        good = is_valid & (amplitude >= 5.0)
        total += _around(np.where(good, bias2 * amplitude**2 / sigma2, 0.0))
        weight += _around(good.astype(float))
        is_valid &= good
    return np.sqrt(np.maximum(total / weight, 0.0)), is_valid


def _around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over a few fringes."""
    return np.asarray(cv2.blur(values, (31, 31)), np.float64)
