"""Images that are made once are the images of what lights them, and nothing else is mistaken for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from hw_sim.optics.projector import LightSlice
from hw_sim.rendering.frame_cache import MOST, FrameCache

PATTERN = np.arange(256, dtype=np.uint8).reshape(16, 16)
LIGHT = (LightSlice(PATTERN, 0.012),)
ASKED: Mapping[str, Any] = {
    "camera": "left",
    "scene": "pipe",
    "slices": LIGHT,
    "exposure_s": 0.012,
    "gain_db": 0.0,
    "lasers": (False, False),
    "frame": 3,
}


def test_the_same_light_is_the_same_image_and_nobody_may_change_it() -> None:
    stills, made = FrameCache(), []

    def make() -> np.ndarray:
        made.append(1)
        return np.zeros((2, 2), np.uint8)

    first = stills.get(stills.key(**ASKED), make)
    again = stills.get(stills.key(**{**ASKED, "slices": (LightSlice(PATTERN.copy(), 0.012),)}), make)
    assert first is again
    assert len(made) == 1
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1


@pytest.mark.parametrize(
    "change",
    [
        {"camera": "right"},
        {"scene": "plane"},
        {"slices": (replace(LIGHT[0], image=PATTERN[::-1]),)},
        {"slices": (replace(LIGHT[0], duration_s=0.006),)},
        {"slices": ()},
        {"exposure_s": 0.006},
        {"gain_db": 6.0},
        {"lasers": (True, False)},
        {"frame": 4},
    ],
    ids=lambda change: next(iter(change)),
)
def test_whatever_changes_the_image_makes_another(change: dict[str, object]) -> None:
    assert FrameCache.key(**{**ASKED, **change}) != FrameCache.key(**ASKED)


def test_the_images_are_bounded_and_the_oldest_goes() -> None:
    stills = FrameCache()
    image = {k: stills.get(k, partial(np.full, 1, k % 256, np.uint8)) for k in range(MOST)}
    stills.get(0, lambda: np.zeros(1, np.uint8))
    stills.get("new", lambda: np.zeros(1, np.uint8))
    assert stills.get(0, lambda: np.ones(1, np.uint8)) is image[0], "asked for lately"
    assert stills.get(1, lambda: np.full(1, 99, np.uint8))[0] == 99, "it was made again"
