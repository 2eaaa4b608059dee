"""Owns where in the left image a movement does its harm: a point, and a word for the diver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.verdict.motion_harm import Harm

EVERYWHERE = 0.4
"""Share of the pixels in harmed cells from which on no side is named."""
OFF_MIDDLE = 0.12
"""Of the image's size: less beside what is seen has no side."""


@dataclass(frozen=True, slots=True)
class Place:
    """Middle of the harm in px of the left image, and ``left right upper lower everywhere`` or two of them."""

    u_px: float
    v_px: float
    word: str


def place_of(harm: Harm, size_px: tuple[int, int]) -> Place | None:
    """``None``: no cell has a ripple."""
    squared = np.nan_to_num(harm.ripple_mm) ** 2 * harm.weight
    total = float(squared.sum())
    if total <= 0.0:
        return None
    u, v = (float(np.sum(squared * np.nan_to_num(x)) / total) for x in (harm.u_px, harm.v_px))
    pixels = harm.weight.sum()
    strong = np.nan_to_num(harm.ripple_mm) ** 2 > 0.25 * total / pixels
    if float(harm.weight[strong].sum()) > EVERYWHERE * pixels:
        return Place(u, v, "everywhere")
    words = []
    middle_u, middle_v = (float(np.sum(harm.weight * np.nan_to_num(x)) / pixels) for x in (harm.u_px, harm.v_px))
    for off, size, names in (
        (v - middle_v, size_px[1], ("upper", "lower")),
        (u - middle_u, size_px[0], ("left", "right")),
    ):
        if abs(off) > OFF_MIDDLE * size:
            words.append(names[int(off > 0.0)])
    return Place(u, v, " ".join(words) or "middle")
