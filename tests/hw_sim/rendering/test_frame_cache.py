"""Images that are made once are the images of what lights them, and nothing else is mistaken for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hw_sim.optics.projector import LightSlice
from hw_sim.rendering.frame_cache import MOST, FrameCache, Image

PATTERN = np.arange(256, dtype=np.uint8).reshape(16, 16)
LIGHT = LightSlice(PATTERN, 0.012)
ASKED: Mapping[str, Any] = {
    "camera": "left", "scene": "pipe", "slices": (LIGHT,), "exposure_s": 0.012, "gain_db": 0.0, "lasers": (False, False), "frame": 3,
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        *({"camera": "right"}, {"scene": "plane"}, {"slices": (replace(LIGHT, image=PATTERN[::-1]),)}, {"frame": 4}),
        *({"slices": (replace(LIGHT, duration_s=0.006),)}, {"slices": ()}, {"exposure_s": 0.006}, {"gain_db": 6.0}),
        {"lasers": (True, False)},
    ],
)
def test_whatever_changes_the_image_makes_another(change: dict[str, object]) -> None:
    assert FrameCache.key(**{**ASKED, "slices": (LightSlice(PATTERN.copy(), 0.012),)}) == FrameCache.key(**ASKED)
    assert FrameCache.key(**{**ASKED, **change}) != FrameCache.key(**ASKED)


def test_an_image_is_made_once_and_the_one_not_asked_for_longest_goes() -> None:
    cache, made = FrameCache(), list[int]()

    def asked(frame: int) -> None:
        def make() -> Image:
            made.append(frame)
            return np.full((2, 2), frame, np.uint8)

        assert cache.get(frame, make).tolist() == [[frame] * 2] * 2

    for frame in (*range(MOST), 0, MOST, 0):
        asked(frame)
    assert made == [*range(MOST + 1)]
    asked(1)
    assert made[-1] == 1
