"""Which scenes are drawn for the world ``outside``, and what is followed over the scans of one instrument."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.outside.draws import OF_THE_INSTRUMENT, SCENES_PER_RIG, scene_world
from bench.outside.health import figures, health_world
from hw_sim.objects.soft import is_soft
from hw_sim.outside import ALL

TINY_PX = 80, 60


def test_scenes_of_one_instrument_share_what_belongs_to_it_and_nothing_else() -> None:
    one, other = (scene_world(10_001, number, size_px=TINY_PX) for number in (0, 1))
    assert one.rig == other.rig
    for name in OF_THE_INSTRUMENT:
        assert getattr(one.scene.outside, name) == getattr(other.scene.outside, name)
    assert one.scene.outside.backscatter != other.scene.outside.backscatter
    assert one.scene.outside.hands != other.scene.outside.hands
    assert one.scene.water != other.scene.water
    assert scene_world(10_001, SCENES_PER_RIG, size_px=TINY_PX).rig.left != one.rig.left


def test_a_family_alone_is_put_before_the_same_scene() -> None:
    whole, alone = (scene_world(10_001, 4, families, TINY_PX, soft=False) for families in (ALL, ("projector",)))
    assert alone.scene.outside.projector == whole.scene.outside.projector
    assert alone.scene.outside.cameras is None
    assert (alone.scene.object, alone.scene.start_pose, alone.scene.water) == (
        whole.scene.object, whole.scene.start_pose, whole.scene.water,
    )  # fmt: skip


def test_about_one_scene_of_ten_is_soft_and_says_so() -> None:
    drawn = [scene_world(10_001, number, size_px=TINY_PX) for number in range(30)]
    soft = [world for world in drawn if world.scene.outside.soft is not None]
    assert 0 < len(soft) < 10
    assert all("soft" in world.families and is_soft(world.seed) for world in soft)


def test_a_knocked_instrument_is_the_same_but_for_the_knock() -> None:
    (normal, stated), (knocked, before) = health_world(1, 3, 10_001), health_world(1, 1000, 10_001)
    assert stated.rig.left.port == before.rig.left.port
    turn = np.array(knocked.rig.right.R) @ np.array(before.rig.right.R).T
    angle_deg = np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    assert 0.015 < angle_deg < 0.03
    assert normal.scene.outside.hands is None


def a_scan(height_um: float, seed: int, faults: tuple[str, ...] = ()) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    patches = np.arange(48)
    modes = np.stack(
        [np.ones(48), patches % 8 - 3.5, patches // 8 - 2.5, (patches % 8 - 3.5) * (patches // 8 - 2.5)], 1
    )
    gaps = {
        "patch": patches.tolist(), "gap_um": (height_um + rng.normal(0.0, 2.0, 48)).tolist(), "noise_um": [2.0] * 48,
        "modes": modes.tolist(), "samples": 5000, "water_index": 1.3345,
    }  # fmt: skip
    return {
        "gaps": gaps, "faults": list(faults), "complete_percent": 99.0, "error_over_sigma": 1.0,
    }  # fmt: skip


def of(rows: dict[int, list[dict[str, Any]]], each: int, name: str) -> float:
    return next(one.value for one in figures(rows, each) if one.name.startswith(name))


def test_a_knock_counts_as_found_only_where_normal_scans_raised_no_alarm() -> None:
    normal = [a_scan(0.0, k) for k in range(8)]
    rows = {
        0: [*normal, *(a_scan(120.0, 20 + k) for k in range(3))],
        1: [*normal, *(a_scan(0.0, 30 + k) for k in range(3))],
    }
    assert of(rows, 8, "rigs whose calibration is doubted") == 0.0
    assert of(rows, 8, "knocks of 0.02") == 1.0
    early = {0: [*normal[:4], *(a_scan(120.0, 20 + k) for k in range(7))]}
    assert of(early, 8, "rigs whose calibration is doubted") == 1.0


def test_false_alarms_after_the_knock_are_no_false_alarms_of_normal_scans() -> None:
    rows = {0: [a_scan(0.0, 1, ("LIGHT_FLICKERS",)), a_scan(0.0, 2), a_scan(0.0, 3, ("LIGHT_FLICKERS",))]}
    assert of(rows, 2, "false alarms of light") == pytest.approx(1.0)
