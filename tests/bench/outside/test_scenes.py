"""Instruments are watched one by one: what one of them is told must not be known to the next."""

from __future__ import annotations

from typing import Any

import numpy as np

from appliance.calibration.health import LIMIT
from appliance.calibration.patches import COUNT
from bench.outside.draws import scene_world
from bench.outside.sample import numbers_of
from bench.outside.scenes import watched


def a_row(rig_seed: int, gap_um: float) -> dict[str, Any]:
    """Return a scan whose rays miss each other by ``gap_um`` in the whole image, known to a tenth of a micrometre."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 8), np.linspace(-1.0, 1.0, COUNT // 8))
    modes = np.stack([np.ones(COUNT), x.ravel(), y.ravel(), (x * y).ravel()], -1)
    gaps = {
        "patch": list(range(COUNT)), "gap_um": [gap_um] * COUNT, "noise_um": [0.1] * COUNT, "modes": modes.tolist(),
        "samples": 5000, "water_index": 1.33, "veil_um": None, "doubts_um": None, "shape_um": None,
    }  # fmt: skip
    return {"rig_seed": rig_seed, "gaps": gaps}


def figures(rows: list[dict[str, Any]]) -> dict[str, float]:
    return {one.name: one.value for one in watched(rows)}


def test_an_instrument_whose_rays_miss_each_other_is_doubted_and_its_neighbour_is_not() -> None:
    found = figures([a_row(1, 0.0), a_row(2, 200.0), a_row(1, 0.0), a_row(2, 200.0)])
    assert found["instruments whose calibration is doubted"] == 1.0
    assert found["largest sum of the watch over the calibration"] > LIMIT
    assert 1.0 <= found["false alarms of the calibration's health"] <= 2.0
    assert found["scans that are judged by the watch over the calibration"] == 4.0


def test_scans_that_tell_nothing_of_the_calibration_raise_no_doubt() -> None:
    assert figures([{"rig_seed": 1, "gaps": None}])["instruments whose calibration is doubted"] == 0.0


def test_a_sample_has_rigid_scenes_from_all_over_the_report_and_its_soft_ones() -> None:
    numbers = numbers_of(30, 1)
    families = {number: scene_world(1, number).families for number in (*numbers, *range(10))}
    soft = [number for number in numbers if "soft" in families[number]]
    assert len(numbers) - len(soft) == 30
    assert len(soft) == 20
    assert numbers[0] < 10
    assert max(number for number in numbers if number not in soft) >= 190
    assert len(set(numbers)) == len(numbers)
