"""Kinds of projectors through the world's wires: drawn into the card, shown in time, seen by a camera that the board triggers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import Recorder, good, greys

PLAIN: Mapping[str, Any] = {
    "width_px": 192, "height_px": 128, "noise": False, "object": "plane", "texture": "none", "ambient": 0.0,
    "water": {"backscatter": 0.0, "attenuation_per_m": 0.4},
}  # fmt: skip


class Rig:
    """A bench with one camera, and a projector that shows black or white."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.truth = bench, bench.world.projector_truth
        self.camera = bench.camera(exposure_us=1000)
        self.card = bench.projector()
        self.black, self.white = (self.card.buffer(picture) for picture in greys([0, 255]))

    def light(self, shown: Sequence[int], delay_us: int, exposure_us: int) -> NDArray[np.float64]:
        """Return the mean grey in the middle of what the camera sees with one pulse for each picture, above its black level."""
        self.camera.put(0x200304, exposure_us)
        recorder = Recorder({"left": self.camera}, self.bench.board, self.card, list(shown), self.bench.size)
        frames = good(recorder.record(delay_us=delay_us)["left"])
        assert len(frames) == len(shown)
        return np.array([f.image[48:80, 72:120].mean() - 2.0 for f in frames])


def test_one_white_picture_among_black_ones_is_seen_so_many_blanks_late(make_bench: Callable[..., Bench]) -> None:
    rig = Rig(make_bench(**PLAIN, projector={"kind": "pattern", "latency_blanks": 3}))
    seen = rig.light([rig.black, rig.black, rig.white, *[rig.black] * 5], 200, 7000)
    assert int(seen.argmax()) == 2 + 3
    assert sorted(seen)[-2] < 0.05 * seen.max()


def test_windows_of_light_are_where_the_truth_says(make_bench: Callable[..., Bench]) -> None:
    rig = Rig(make_bench(**PLAIN, projector={"kind": "video", "latency_blanks": 0, "late_us": 400.0}))
    delays_us = range(0, 16_000, 3200)
    expected_us = np.array([rig.truth.light_of_codes(delay_us, 1000.0, "G")[255] for delay_us in delays_us])
    seen = np.array([rig.light([rig.white] * 2, delay_us, 1000)[1] for delay_us in delays_us])
    assert np.ptp(expected_us) > 900.0, "light and dark"
    per_us = seen[expected_us > 900.0].mean() / expected_us[expected_us > 900.0].mean()
    assert seen == pytest.approx(per_us * expected_us, abs=1.0), "DN"
