"""Kinds of projectors through the world's wires: drawn into the card, shown in time, seen by a camera that the board triggers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.world import World
from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import BoardHost, CardHost, Recorder, U3vHost, good

pytestmark = pytest.mark.devices

WIDTH, HEIGHT = 192, 128
PLAIN: Mapping[str, Any] = {
    "width_px": WIDTH, "height_px": HEIGHT, "noise": False, "object": "plane", "texture": "none", "ambient": 0.0,
    "water": {"backscatter": 0.0, "attenuation_per_m": 0.4},
}  # fmt: skip
FRAME_US = 50_000.0 / 3.0
Image = NDArray[np.uint8]
MakeBench = Callable[..., Bench]


class Rig:
    """A bench with one camera, and pictures of three channels on its projector."""

    def __init__(self, make_bench: MakeBench, projector: object, **options: Any) -> None:
        self.bench = make_bench(**{**PLAIN, "projector": projector, **options})
        self.world: World = self.bench.world
        self.camera: U3vHost = self.bench.camera(exposure_us=1000)
        self.card: CardHost = self.bench.projector()
        self.board: BoardHost = self.bench.board

    def draw(self, *pictures: Image) -> list[int]:
        """Draw (h, w) grey or (h, w, 3) red, green, blue pictures."""
        made = []
        for picture in pictures:
            index = self.card.buffer(picture if picture.ndim == 2 else picture[..., 1])
            if picture.ndim == 3:
                self.card.fbs[index][1][:, :, :3] = picture[..., ::-1]
            made.append(index)
        return made

    def see(self, shown: Sequence[int], delay_us: int, exposure_us: int) -> list[NDArray[np.float64]]:
        """Return what the camera sees with one pulse for each picture that is flipped, above its black level."""
        self.camera.put(0x200304, exposure_us)
        recorder = Recorder({"left": self.camera}, self.board, self.card, list(shown), self.bench.size)
        frames = good(recorder.record(delay_us=delay_us)["left"])
        assert len(frames) == len(shown)
        return [f.image.astype(float) - 2.0 for f in frames]

    def light(self, shown: Sequence[int], delay_us: int, exposure_us: int) -> NDArray[np.float64]:
        """Return the mean grey in the middle of each image."""
        images = self.see(shown, delay_us, exposure_us)
        return np.array([image[48:80, 72:120].mean() for image in images])


def grey(code: int) -> Image:
    return np.full((768, 1024), code, np.uint8)


def colour(red: int, green: int, blue: int) -> Image:
    return np.tile(np.array([red, green, blue], np.uint8), (768, 1024, 1))


@pytest.mark.parametrize(
    ("projector", "latency"),
    [("ideal", 0), ("video", 1), ("pattern", 1), ("repeats", 1), ({"kind": "pattern", "latency_blanks": 3}, 3)],
)
def test_one_white_picture_among_black_ones_is_seen_so_many_blanks_late(
    make_bench: MakeBench, projector: object, latency: int
) -> None:
    rig = Rig(make_bench, projector)
    assert rig.world.projector_truth.latency_blanks == latency
    black, white = rig.draw(grey(0), grey(255))
    seen = rig.light([black, black, white, *[black] * 5], 200, 7000)
    assert int(seen.argmax()) == 2 + latency
    assert sorted(seen)[-2] < 0.05 * seen.max()


def test_windows_of_light_are_where_the_truth_says(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "video", "latency_blanks": 0, "late_us": 400.0})
    (white,) = rig.draw(colour(0, 255, 0))
    truth = rig.world.projector_truth
    delays_us = range(0, 16_000, 1600)
    expected_us = np.array([truth.light_of_codes(delay_us, 1000.0, "G")[255] for delay_us in delays_us])
    seen = np.array([rig.light([white] * 2, delay_us, 1000)[1] for delay_us in delays_us])
    assert np.ptp(expected_us) > 900.0, "light and dark"
    per_us = seen[expected_us > 900.0].mean() / expected_us[expected_us > 900.0].mean()
    assert seen == pytest.approx(per_us * expected_us, abs=1.0), "DN"


def test_red_and_blue_light_only_where_they_are_drawn(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "video", "colour_weights": [0.5, 1.0, 0.25]})
    shown = rig.draw(colour(0, 0, 0), colour(255, 0, 0), colour(0, 255, 0), colour(0, 0, 255), colour(255, 255, 255))
    black, red, green, blue, white = rig.light([shown[0], *shown[1:], shown[0], shown[0]], 120, 16_600)[1:6]
    assert black < 0.03 * white
    assert red / green == pytest.approx(0.5 * 0.27 / 0.45, abs=0.02)
    assert blue / green == pytest.approx(0.25 * 0.22 / 0.45, abs=0.02)
    assert white == pytest.approx(red + green + blue, rel=0.03)


@pytest.mark.parametrize(("kind", "exact_us"), [("pattern", FRAME_US / 3.0), ("repeats", FRAME_US / 2.0)])
def test_whole_sub_frames_are_linear_in_the_code_and_parts_are_not(
    make_bench: MakeBench, kind: str, exact_us: float
) -> None:
    rig = Rig(make_bench, kind)
    codes = np.array([0, 32, 63, 64, 95, 127, 128, 160, 191, 192, 223, 255])
    shown = rig.draw(*(grey(int(code)) for code in codes))
    truth = rig.world.projector_truth
    delay_us = round(truth.windows_us[0].begin_us)
    # Each picture stays for two blanks: the second image is its own, with latency 1.
    twice = [index for index in shown for _ in range(2)]
    for exposure_us in (round(exact_us), 2000):
        light = rig.light(twice, delay_us, exposure_us)[1::2]
        expected = truth.light_of_codes(delay_us, exposure_us)[codes]
        line = np.polyval(np.polyfit(codes, light, 1), codes)
        residual = np.abs(light - line).max() / light.max()
        assert light / light.max() == pytest.approx(expected / expected.max(), abs=0.01)
        if exposure_us == 2000:
            assert residual > 0.03
            assert not truth.linear(delay_us, exposure_us)
        else:
            assert residual < 0.01
            assert truth.linear(delay_us, exposure_us)


def test_pattern_mode_shows_each_channel_in_a_third_of_the_frame(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "pattern", "order": "BRG", "latency_blanks": 0})
    shown = rig.draw(colour(255, 0, 0), colour(0, 255, 0), colour(0, 0, 255))
    for window in rig.world.projector_truth.windows_us:
        seen = rig.light(shown, round(window.begin_us), round(window.end_us - window.begin_us))
        assert int(seen.argmax()) == "RGB".index(window.channel)
        assert sorted(seen)[1] < 0.05 * seen.max()


def test_a_long_exposure_sees_all_frames_that_light_during_it(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, "video")
    shown = rig.draw(grey(0), grey(40))
    one = rig.light([shown[1]] * 4, 120, 16_600)[-1]
    camera = rig.camera
    camera.put(0x200304, 50_000)
    camera.put(0x200200, 0)  # it runs freely
    frames = [camera.frame(payload=WIDTH * HEIGHT) for _ in range(4)]
    held = frames[-1].image.astype(float)[48:80, 72:120].mean() - 2.0
    assert held == pytest.approx(3.0 * one, rel=0.05)


def test_a_gamma_that_was_left_on_bends_the_light(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "pattern", "gamma": 2.2, "latency_blanks": 0})
    light = rig.light(rig.draw(grey(0), grey(128), grey(255)), 120, 5556)
    assert (light[1] - light[0]) / (light[2] - light[0]) == pytest.approx((128 / 255) ** 2.2, abs=0.015)


def test_a_mirrored_picture_lights_the_other_side(make_bench: MakeBench) -> None:
    halves = np.zeros((768, 1024), np.uint8)
    halves[:, :512] = 255
    corner = np.zeros((768, 1024), np.uint8)
    corner[:384] = 255
    seen = {}
    for name, projector in {
        "usual": {"kind": "ideal"},
        "mirrored": {"mirrored": True},
        "upside down": {"upside_down": True},
    }.items():
        rig = Rig(make_bench, projector)
        left, top = rig.see(rig.draw(halves, corner), 500, 4000)
        seen[name] = (
            float(left[:, :96].mean() - left[:, 96:].mean()),
            float(top[:64].mean() - top[64:].mean()),
        )
        assert int(rig.world.scanned_out("projector")[0, 0]) == (0 if name == "upside down" else 255)
    usual, mirrored, down = seen["usual"], seen["mirrored"], seen["upside down"]
    assert abs(usual[0]) > 10.0
    assert abs(usual[1]) > 10.0
    assert mirrored[0] * usual[0] < 0.0 < mirrored[1] * usual[1]
    assert down[1] * usual[1] < 0.0 < down[0] * usual[0]


def test_a_scaled_raster_keeps_the_place_of_wide_stripes_and_weakens_single_columns(make_bench: MakeBench) -> None:
    columns = np.arange(1024)
    stripes = [np.tile((columns // n % 2 * 255).astype(np.uint8), (768, 1)) for n in (64, 2)]
    wide, fine = [], []
    for more in ({}, {"scaled": [912, 1140]}):
        rig = Rig(make_bench, {"gamma": 1.0, **more}, width_px=1600, height_px=1200)
        shown = rig.see(rig.draw(*stripes), 500, 3000)
        wide.append(shown[0][560:640, 640:960])
        fine.append(shown[1][560:640, 640:960].mean(axis=0))
    assert np.abs(wide[1] - wide[0]).mean() < 0.05 * wide[0].mean(), "where they were"
    assert fine[1].std() < 0.9 * fine[0].std(), "columns of 2 px lose contrast"


def test_the_family_projector_of_the_harsher_world_dims_the_frames_of_a_kind(make_bench: MakeBench) -> None:
    light: dict[float, float] = {}
    for droop in (0.0, 0.5):
        rig = Rig(make_bench, "pattern", outside={"projector": {"droop": droop, "droop_s": 0.01, "cycles": 3}})
        light[droop] = float(rig.light(rig.draw(*[grey(255)] * 6), 120, 5556)[-1])
    assert light[0.5] == pytest.approx(0.5 * light[0.0], rel=0.03), "brightness acts; its bit planes are the kind's"


def test_the_picture_that_lights_is_the_one_of_a_blank_ago(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "video", "latency_blanks": 3})
    black, white = rig.draw(grey(0), grey(250))
    # More often than the latency, so that nothing older lights when white comes.
    for _ in range(6):
        rig.card.show(black)
    rig.card.show(white)
    seen = [int(rig.world.scanned_out("projector")[0, 0])]
    for _ in range(6):
        rig.card.show(white)
        seen.append(int(rig.world.scanned_out("projector")[0, 0]))
    assert seen[0] == 0
    assert seen[-1] == 250
    assert 2 <= seen.count(0) <= 4, "three blanks, unless a blank passed between call and look"


def test_pictures_that_no_exposure_saw_are_kept_until_they_light(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "pattern", "latency_blanks": 2})
    rig.card.fbs[0][1][:, :, :3] = 255
    (black,) = rig.draw(grey(0))
    # The recorder shows the first buffer until its first pulse, and no camera looks before.
    seen = rig.light([black] * 4, 120, 5556)
    assert seen[:2].min() > 0.9 * seen.max() > 10.0
    assert seen[2:].max() < 0.05 * seen.max()
