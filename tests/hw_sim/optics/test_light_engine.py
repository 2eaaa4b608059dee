"""The projector in time, space and colour: whole frames, parts of frames, the field of light, the focus, and indices by colour."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hw_sim.heat import Housing, Powers
from hw_sim.optics.light_engine import (
    FRAME_S,
    LAMP_RISE_K,
    SOFTEST_PX,
    LightEngine,
    flashed_between,
    sapphire_index,
)
from hw_sim.optics.projector import LightSlice, defocus_px, light_between, response
from hw_sim.outside import Outside, draw_outside
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, with_glass

ENGINES = [engine for seed in range(6) if (engine := draw_outside(seed, ["projector"]).projector) is not None]
WHITE = np.full((768, 1024), 255, np.uint8)


@pytest.mark.parametrize("engine", ENGINES, ids=[str(k) for k in range(6)])
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


def test_a_part_of_a_frame_sees_some_bits_more_than_others_and_which_depends_on_when() -> None:
    table = response("linear")
    worst, moved = [], []
    for engine in ENGINES:
        early, late = (engine.table_s(table, a, a + 0.012) / 0.012 for a in (0.0005, 0.0035))
        worst.append(max(np.abs(early - early[255] * table).max(), np.abs(late - late[255] * table).max()))
        moved.append(np.abs(early - late).max())
    assert max(moved) > 0.01, "unless the exposure takes whole cycles"
    assert max(worst) > 0.01, "a hundredth of white"
    # One mirror alone: the bit of half the light, with one cycle and without its neighbours.
    one = LightEngine(cycles=1, order=5)
    bits, ends = one.pieces()
    longest = 9
    wanted = sum(
        max(0.0, min(0.008, end * FRAME_S) - start * FRAME_S)
        for bit, start, end in zip(bits, [0.0, *ends[:-1]], ends, strict=True)
        if bit == longest
    )
    assert one.lit_s(0.0, 0.008)[longest] == pytest.approx(wanted)
    assert np.bincount(bits, np.diff([0.0, *ends]))[longest] == pytest.approx(512.0 / 1023.0)


def test_many_cycles_are_constant_light() -> None:
    table = response()
    quick = LightEngine(cycles=16).table_s(table, 0.0013, 0.0131)
    np.testing.assert_allclose(quick / 0.0118, table, atol=0.01)
    same = flashed_between(LightEngine(), (LightSlice(WHITE[:2, :2], 0.012),), 0.0, 0.012, table, 3, 0.5, 1)
    ordinary = light_between((LightSlice(WHITE[:2, :2], 0.012),), 0.0, 0.012, table)
    assert same is not None
    assert ordinary is not None
    np.testing.assert_allclose(same, ordinary, rtol=1e-6)


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


def test_both_cameras_see_the_same_brightness_of_the_same_frame() -> None:
    scene = Scene("plane", texture="none", noise=False, ambient=0.0)
    shaky = replace(scene, outside=Outside(projector=LightEngine(frame_rms=0.1)))
    renderer = Renderer(draw_truth("nominal", 1, 160, 120, scene.index), shaky)

    def level(camera: str, clock_s: float) -> float:
        light = [LightSlice(np.full((768, 1024), 200, np.uint8), 0.012)]
        image = renderer.expose(camera, light, 0.0, 0.012, 0.0, (False, False), 1, clock_s)
        return float(image[50:70, 60:100].mean()) - 2.0

    left, right = (np.array([level(camera, 1.0 + k * FRAME_S) for k in range(5)]) for camera in ("left", "right"))
    assert np.std(left) / np.mean(left) > 0.03
    np.testing.assert_allclose(left / left[0], right / right[0], atol=0.015)


@pytest.mark.parametrize("engine", ENGINES, ids=[str(k) for k in range(6)])
def test_a_drawn_lamp_is_a_fifth_brighter_in_one_place(engine: LightEngine) -> None:
    u, v = np.meshgrid(np.arange(0.0, 1024.0, 16.0), np.arange(0.0, 768.0, 16.0))
    field = engine.field(np.stack([u, v], -1), 1024.0, 768.0)
    assert field.max() > 1.2 * field.min()
    assert engine.field(np.array([[511.5, 383.5]]), 1024.0, 768.0)[0] == pytest.approx(1.0)
    j, i = np.unravel_index(np.argmax(field), field.shape)
    assert abs(u[j, i] - 512.0 - 1024.0 * engine.hot_x) < 17.0
    assert abs(v[j, i] - 384.0 - 1024.0 * engine.hot_y) < 17.0


def test_the_picture_shows_the_hot_spot() -> None:
    scene = Scene("plane", (0.0, 0.0, 522.5, 0.0, 0.0, 0.0), "none", noise=False, ambient=0.0)
    spot = LightEngine(hot_spot=0.4, hot_x=-0.15, hot_width=0.25)
    truth = draw_truth("nominal", 1, 160, 120, scene.index)
    renderer, light = Renderer(truth, scene), [LightSlice(np.full((768, 1024), 150, np.uint8), 0.012)]
    ordinary = renderer.expose("left", light, 0.0, 0.012, 0.0, (False, False), 1).astype(float)
    uv = renderer.view("left", 0.0).projector_px
    renderer.scene = replace(scene, outside=Outside(projector=spot))
    made = renderer.expose("left", light, 0.0, 0.012, 0.0, (False, False), 1).astype(float)
    well = (ordinary > 40.0) & np.isfinite(uv[..., 0])
    axis = (np.hypot(uv[..., 0] - 511.5, uv[..., 1] - 383.5) * 10.8e-3 / 16.9)[well]
    # The ordinary lamp's law is cos⁴ of the angle in water.
    cosine4 = (1.0 - (np.sin(np.arctan(axis)) / scene.index) ** 2) ** 2
    wanted = spot.field(uv[well], 1024.0, 768.0) / cosine4
    ratio = (made[well] - 2.0) / (ordinary[well] - 2.0)
    assert np.percentile(np.abs(ratio / wanted - 1.0), 90) < 0.04


def test_the_focus_lies_on_a_bent_and_tilted_surface() -> None:
    depth_mm, size = 44.0, (1024.0, 768.0)
    middle, corner, right = [[511.5, 383.5]], [[1023.5, 767.5]], [[1023.5, 383.5]]
    engine = LightEngine(focus_bend_mm=30.0, focus_tilt_x_mm=-8.0)

    def soft(at: list[list[float]], way_mm: float, of: LightEngine = engine, spread: float = 0.0) -> float:
        return float(of.softness(np.array(at), np.array([way_mm]), depth_mm, size, spread)[0])

    assert soft(middle, 487.5) == pytest.approx(0.0, abs=1e-9)
    assert soft(corner, 487.5 + 30.0 - 8.0) == pytest.approx(0.0, abs=1e-9)
    assert soft(right, 487.5 + 30.0 / 1.5625 - 8.0) == pytest.approx(0.0, abs=1e-9)
    assert soft(corner, 487.5) > 0.001
    assert soft(middle, 560.0, LightEngine()) == pytest.approx((float(defocus_px(560.0, depth_mm)) / SOFTEST_PX) ** 2)
    assert soft(middle, 560.0 - 145.0) > soft(middle, 560.0), "nearer is softer than farther"
    assert soft(corner, 509.5, spread=4e-4) > soft(middle, 487.5, spread=4e-4)


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
    warm = LightEngine(led_nm_per_k=0.05)
    (cold_nm, shares), (warm_nm, _) = warm.spectrum(4.0), warm.spectrum(29.0)
    assert float(shares @ (warm_nm - cold_nm)) == pytest.approx(1.25)


def test_the_lamp_is_as_warm_as_the_housing_makes_it() -> None:
    settled = Housing(20.0).settled(Powers(projector_lit=True, streaming=True))["TPROJ"]
    assert settled - 20.0 == pytest.approx(LAMP_RISE_K, abs=8.0)


@pytest.mark.parametrize("strengths", [{"cycles": -1}, {"hot_spot": 1.0}, {"led_shift_nm": 99.0}])
def test_impossible_projectors_are_refused(strengths: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"projector: {next(iter(strengths))} = .*; allowed are"):
        LightEngine(**strengths)  # type: ignore[arg-type]
