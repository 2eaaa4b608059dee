"""The projector in time, space and colour: whole frames, parts of frames, the field of light, the focus, and indices by colour."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hw_sim.optics.light_engine import FRAME_S, LightEngine, flashed_between, sapphire_index
from hw_sim.optics.projector import LightSlice, response
from hw_sim.outside import Outside, draw_outside
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, with_glass

ENGINES = [engine for seed in range(3) if (engine := draw_outside(seed, ["projector"]).projector) is not None]


@pytest.mark.parametrize("engine", ENGINES, ids=[str(k) for k in range(3)])
def test_a_whole_frame_gives_the_response_and_parts_of_it_add_up(engine: LightEngine) -> None:
    table = response()
    whole = engine.table_s(table, 0.0, FRAME_S)
    np.testing.assert_allclose(whole / FRAME_S, table, atol=1.0 / 1023.0)
    cuts = [0.0, 0.0021, 0.0077, 0.0121, FRAME_S]
    parts = sum(engine.table_s(table, a, b).astype(float) for a, b in pairwise(cuts))
    np.testing.assert_allclose(parts, whole, atol=1e-8)
    assert engine.lit_s(0.0, FRAME_S).sum() == pytest.approx(FRAME_S * (1.0 - engine.dark_part))
    later = engine.table_s(table, 7.0 * FRAME_S + 0.002, 7.0 * FRAME_S + 0.006)
    np.testing.assert_allclose(later, engine.table_s(table, 0.002, 0.006), atol=1e-8, err_msg="every frame is the same")


def test_slices_take_their_place_in_the_frame() -> None:
    table, engine = response("linear"), replace(ENGINES[0], frame_rms=0.0, droop=0.0)
    image = np.full((1, 1), 200, np.uint8)
    # 4 ms up to a blank and 8 ms from it on are the end and the beginning of frames.
    slices = (LightSlice(image, 0.004, FRAME_S - 0.004), LightSlice(image, 0.008, 0.0))
    made = flashed_between(engine, slices, 0.0, 0.012, table, 0, 0.0, 1)
    wanted = engine.table_s(table, FRAME_S - 0.004, FRAME_S)[200] + engine.table_s(table, 0.0, 0.008)[200]
    assert made is not None
    assert made[0, 0] == pytest.approx(wanted, rel=1e-5)
    halves = [flashed_between(engine, slices, a, a + 0.006, table, 0, 0.0, 1) for a in (0.0, 0.006)]
    assert sum(float(half[0, 0]) for half in halves if half is not None) == pytest.approx(wanted, rel=1e-5)


def test_frames_differ_in_brightness_and_the_lamp_fades_as_it_warms() -> None:
    engine = LightEngine(frame_rms=0.003, droop=0.01, droop_s=0.5)
    bright = np.array([engine.brightness(k, 0.0, 1) for k in range(3000)])
    assert bright.std() == pytest.approx(0.003, rel=0.05)
    assert bright.mean() == pytest.approx(1.0, abs=3e-4)
    assert engine.brightness(5, 0.0, 1) == engine.brightness(5, 0.0, 1) != engine.brightness(5, 0.0, 2)
    still = replace(engine, frame_rms=0.0)
    assert still.brightness(0, 0.5, 1) == pytest.approx(1.0 - 0.01 * 0.6321, abs=1e-5)
    assert still.brightness(0, 60.0, 1) == pytest.approx(0.99)


def test_indices_go_by_colour() -> None:
    assert sapphire_index(587.6) == pytest.approx(1.7682, abs=2e-4), "handbooks: 1.768"
    assert sapphire_index(520.0) > sapphire_index(540.0)
    scene = Scene()
    green = replace(scene, outside=Outside(projector=LightEngine(led_shift_nm=0.0)))
    assert green.index == pytest.approx(scene.index, abs=1e-6)
    red = replace(scene, outside=Outside(projector=LightEngine(led_shift_nm=10.0, led_width_nm=30.0)))
    assert scene.index - red.index == pytest.approx(4.1e-4, rel=0.1)
    truth = draw_truth("realistic", 1, 160, 120, red.index)
    coloured = with_glass(truth, red.glass_more)
    for name in ("left", "right", "projector"):
        less = truth.eye(name).port.n_g - coloured.eye(name).port.n_g
        assert less == pytest.approx(sapphire_index(530.0) - sapphire_index(540.0), rel=0.05)
    assert np.ptp(LightEngine().spectrum(20.0)[0]) == 0.0, "the usual lamp has one colour"
    warm = LightEngine(led_nm_per_k=0.05)
    (cold_nm, shares), (warm_nm, _) = warm.spectrum(4.0), warm.spectrum(29.0)
    assert float(shares @ (warm_nm - cold_nm)) == pytest.approx(1.25)
