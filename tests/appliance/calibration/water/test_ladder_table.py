"""The table of docs/calibration.md: every method on eight rigs that nobody knows, judged at poses that were not used."""

from __future__ import annotations

import time

import numpy as np
import pytest

from appliance.calibration.water.interface import SearchSettings
from appliance.calibration.water.ladder import LadderSettings, Method, calibrate
from tests.support.calibrating import (
    CALIBRATION_BARS,
    CALIBRATION_PLANES,
    MORE_BARS,
    MORE_PLANES,
    air_of,
    board_views,
    calibration_recordings,
    evaluate,
    hidden_rig,
    start_of,
)

SEEDS = range(1, 9)
PUBLISHED = LadderSettings(search=SearchSettings(noise_free=False))
WITH_TEN = (Method.BA_PORTS, Method.BA_ALL, Method.BA_SPLINE, Method.RAY_FIELD)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_eight_hidden_rigs_reach_the_stated_accuracy() -> None:
    found: dict[str, list[tuple[float, float, float, float]]] = {}
    for seed in SEEDS:
        truth = hidden_rig("realistic", seed)
        start = start_of(air_of(truth))
        four = calibration_recordings(truth)
        ten = calibration_recordings(truth, (*CALIBRATION_BARS, *MORE_BARS), (*CALIBRATION_PLANES, *MORE_PLANES))
        boards = board_views(truth, 15, 3, wet=True)
        runs = [(m.value, m, four, LadderSettings()) for m in Method]
        runs.append(("rm, published flatness", Method.RM, four, PUBLISHED))
        runs += [(f"{m.value}, six more", m, ten, LadderSettings()) for m in WITH_TEN]
        rigs = [("air, ports as drawn", start.rig, 0.0)]
        for name, method, recordings, settings in runs:
            begun = time.process_time()
            rig = calibrate(method, recordings, start, settings=settings, boards=boards).calibration.rig
            rigs.append((name, rig, time.process_time() - begun))
        for name, rig, cpu_s in rigs:
            errors = evaluate(truth, rig, frustums=7)
            found.setdefault(name, []).append((errors.length, errors.frustum, errors.flatness, cpu_s))
    median = {name: np.median(values, axis=0) for name, values in found.items()}
    worst = {name: np.max(values, axis=0) for name, values in found.items()}
    for name in found:
        m, w = median[name], worst[name]
        print(
            f"| {name} | {m[0]:.3f} % | {w[0]:.3f} % | {m[1]:.3f} % | {w[1]:.3f} % | {m[2]:.3f} % | {w[2]:.3f} % "
            f"| {m[3]:.1f} s |"
        )
    assert median["ba_ports"][0] < 0.04
    assert worst["ba_ports"][0] < 0.08
    assert median["ba_spline"][0] < 0.035
    assert median["ba_spline"][2] < 0.03
    for name in ("ba_spline, six more", "ray_field, six more"):
        assert median[name][0] < 0.02
        assert median[name][1] < 0.05
