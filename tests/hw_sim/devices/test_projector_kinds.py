"""Kinds of projectors through the world's wires: drawn into the card, shown in time, seen by a camera that the board triggers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import Recorder, good

WIDTH, HEIGHT = 192, 128
PLAIN: Mapping[str, Any] = {
    "width_px": WIDTH, "height_px": HEIGHT, "noise": False, "object": "plane", "texture": "none", "ambient": 0.0,
    "water": {"backscatter": 0.0, "attenuation_per_m": 0.4},
}  # fmt: skip
Image = NDArray[np.uint8]
MakeBench = Callable[..., Bench]


class Rig:
    """A bench with one camera, and pictures of three channels on its projector."""

    def __init__(self, make_bench: MakeBench, projector: object) -> None:
        self.bench = make_bench(**{**PLAIN, "projector": projector})
        self.truth = self.bench.world.projector_truth
        self.camera = self.bench.camera(exposure_us=1000)
        self.card = self.bench.projector()

    def draw(self, *pictures: Image) -> list[int]:
        """Draw (h, w, 3) red, green, blue pictures."""
        made = []
        for picture in pictures:
            index = self.card.buffer(picture[..., 1])
            self.card.fbs[index][1][:, :, :3] = picture[..., ::-1]
            made.append(index)
        return made

    def see(self, shown: Sequence[int], delay_us: int, exposure_us: int) -> list[NDArray[np.float64]]:
        """Return what the camera sees with one pulse for each picture that is flipped, above its black level."""
        self.camera.put(0x200304, exposure_us)
        recorder = Recorder({"left": self.camera}, self.bench.board, self.card, list(shown), self.bench.size)
        frames = good(recorder.record(delay_us=delay_us)["left"])
        assert len(frames) == len(shown)
        return [f.image.astype(float) - 2.0 for f in frames]

    def light(self, shown: Sequence[int], delay_us: int, exposure_us: int) -> NDArray[np.float64]:
        """Return the mean grey in the middle of each image."""
        return np.array([image[48:80, 72:120].mean() for image in self.see(shown, delay_us, exposure_us)])


def colour(red: int, green: int, blue: int) -> Image:
    return np.tile(np.array([red, green, blue], np.uint8), (768, 1024, 1))


def grey(code: int) -> Image:
    return colour(code, code, code)


def test_one_white_picture_among_black_ones_is_seen_so_many_blanks_late(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "pattern", "latency_blanks": 3})
    assert rig.truth.latency_blanks == 3
    black, white = rig.draw(grey(0), grey(255))
    seen = rig.light([black, black, white, *[black] * 5], 200, 7000)
    assert int(seen.argmax()) == 2 + 3
    assert sorted(seen)[-2] < 0.05 * seen.max()


def test_windows_of_light_are_where_the_truth_says(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, {"kind": "video", "latency_blanks": 0, "late_us": 400.0})
    (white,) = rig.draw(colour(0, 255, 0))
    delays_us = range(0, 16_000, 3200)
    expected_us = np.array([rig.truth.light_of_codes(delay_us, 1000.0, "G")[255] for delay_us in delays_us])
    seen = np.array([rig.light([white] * 2, delay_us, 1000)[1] for delay_us in delays_us])
    assert np.ptp(expected_us) > 900.0, "light and dark"
    per_us = seen[expected_us > 900.0].mean() / expected_us[expected_us > 900.0].mean()
    assert seen == pytest.approx(per_us * expected_us, abs=1.0), "DN"


def test_whole_sub_frames_are_linear_in_the_code_and_parts_are_not(make_bench: MakeBench) -> None:
    rig = Rig(make_bench, "pattern")
    codes = np.array([0, 63, 64, 127, 128, 255])
    # Each picture stays for two blanks: the second image is its own, with latency 1.
    twice = [index for index in rig.draw(*(grey(int(code)) for code in codes)) for _ in range(2)]
    delay_us = round(rig.truth.windows_us[0].begin_us)
    for exposure_us, linear in ((5556, True), (2000, False)):  # a third of a frame, and less
        light = rig.light(twice, delay_us, exposure_us)[1::2]
        expected = rig.truth.light_of_codes(delay_us, exposure_us)[codes]
        assert light / light.max() == pytest.approx(expected / expected.max(), abs=0.01)
        residual = np.abs(light - np.polyval(np.polyfit(codes, light, 1), codes)).max() / light.max()
        assert residual < 0.01 if linear else residual > 0.03
        assert rig.truth.linear(delay_us, exposure_us) == linear


def test_a_mirrored_picture_lights_the_other_side(make_bench: MakeBench) -> None:
    halves, corner = grey(0), grey(0)
    halves[:, :512] = corner[:384] = 255

    def sides(projector: object) -> tuple[float, float]:
        rig = Rig(make_bench, projector)
        left, top = rig.see(rig.draw(halves, corner), 500, 4000)
        return float(left[:, :96].mean() - left[:, 96:].mean()), float(top[:64].mean() - top[64:].mean())

    usual, mirrored = sides("ideal"), sides({"mirrored": True})
    assert min(map(abs, usual)) > 10.0
    assert mirrored[0] * usual[0] < 0.0 < mirrored[1] * usual[1]
