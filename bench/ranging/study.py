"""Study of ranging: random instruments and scenes, each measured distance against the true one."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.ranger import Dot, Dots
from appliance.instrument.ranging.reach import Range
from appliance.instrument.service.settings import live_light_of
from appliance.store.config import load_rig
from bench.ranging.scenes import Case, aimed, drawn, is_visible
from hw_sim.rendering.render import Renderer
from tests.support.pointed import RIG_FILE, Instrument, hide, instrument, live_pair, true_dots, truth_of
from tests.support.truth import rig_to_left

SCENES_PER_RIG = 10
POSED = ("free", "free-aimed", "guided", "guided-aimed")
"""As it comes; the ball bar as the sketches of the calibration show it; and either with a dot brought onto the ball bar."""
MOVED_AT_S = 0.3
PAIRS_BEFORE, PAIR_S = 3, 0.1
"""Live pairs that the instrument saw of the scene before the one that is judged."""


def _look_before(
    device: Instrument, renderer: Renderer, case: Case, seed: int, light: NDArray[np.uint8], time_s: float
) -> None:
    nothing = np.zeros((device.truth.left.height_px, device.truth.left.width_px), np.uint8)
    device.ranger.find((nothing, nothing))
    for k in range(PAIRS_BEFORE):
        before_s = max(0.0, time_s - (PAIRS_BEFORE - k) * PAIR_S)
        dots = true_dots(renderer, device.truth, before_s)
        device.ranger.find(_pair(device, renderer, case, dots, 1_000_000 + 10 * seed + k, light, before_s)[0])


def _used(dot: Dot | None, measured: Range | None) -> bool:
    """Return True if the distance comes from ``dot``: from both dots if on one surface, else from one of them."""
    if dot is None or measured is None:
        return False
    return measured.tilt_deg is not None or dot.position_mm[2] == measured.distance_mm


def _pair(
    device: Instrument, renderer: Renderer, case: Case, dots: list[NDArray[np.float64] | None], seed: int,
    light: NDArray[np.uint8], time_s: float,
) -> tuple[tuple[NDArray[np.uint8], NDArray[np.uint8]], bool]:  # fmt: skip
    """Return a live image pair, and whether a weed hides a dot in it."""
    left, right = live_pair(renderer, (True, True), seed, light, time_s)
    dot = dots[case.hidden[1]] if case.hidden is not None else None
    if case.hidden is None or dot is None:
        return (left, right), False
    if case.hidden[0] == "left":
        return (hide(left, device.truth, "left", dot), right), True
    return (left, hide(right, device.truth, "right", dot)), True


def row(device: Instrument, case: Case, seed: int, light: NDArray[np.uint8]) -> dict[str, Any]:
    """Measure one live image pair."""
    renderer = Renderer(device.truth, case.scene)
    time_s = 0.0 if case.scene.motion.still else MOVED_AT_S
    dots = true_dots(renderer, device.truth, time_s)
    (left, right), hidden = _pair(device, renderer, case, dots, seed, light, time_s)
    views = {
        (side, k): dot is not None and is_visible(renderer, device.truth, side, dot, time_s)
        for side in ("left", "right")
        for k, dot in enumerate(dots)
    }
    if hidden and case.hidden is not None:
        views[case.hidden] = False
    begun = time.process_time()
    dots_found: Dots = device.ranger.find((left, right))
    measured = device.ranger.range_of(dots_found)
    cpu_ms = 1e3 * (time.process_time() - begun)
    if measured is None:
        # Image pairs before this one are made here, because some dots are accepted only after several pairs.
        _look_before(device, renderer, case, seed, light, time_s)
        dots_found = device.ranger.find((left, right))
        measured = device.ranger.range_of(dots_found)
    device.ranger.learn(dots_found)
    true_mm, true_deg = truth_of(
        device,
        [
            dot if _used(got, measured) else None
            for dot, got in zip(dots, (dots_found.left, dots_found.right), strict=True)
        ],
    )
    places = [
        None if dot is None else device.ranger.frame.from_left(rig_to_left(device.truth, dot[None])[0]) for dot in dots
    ]
    dot_errors = [
        None if got is None or place is None else float(got.position_mm[2] - place[2])
        for got, place in zip((dots_found.left, dots_found.right), places, strict=True)
    ]
    true_distances = [float(place[2]) for place in places if place is not None]
    return {
        "object": case.scene.object,
        "texture": case.scene.texture,
        "water": case.water,
        "ambient": case.scene.ambient,
        "moving": not case.scene.motion.still,
        "hidden": case.hidden is not None,
        "true_mm": float(np.mean(true_distances)) if true_distances else None,
        "both_see": sum(views["left", k] and views["right", k] for k in range(2)),
        "one_sees": sum(views["left", k] != views["right", k] for k in range(2)),
        "distance_mm": None if measured is None else measured.distance_mm,
        "sigma_mm": None if measured is None else measured.sigma_mm,
        "dots": len(dots_found.present),
        "cameras": [None if got is None else got.cameras for got in (dots_found.left, dots_found.right)],
        "contrast_dn": [None if got is None else got.contrast_dn for got in (dots_found.left, dots_found.right)],
        "error_mm": None if measured is None or true_mm is None else measured.distance_mm - true_mm,
        "dot_errors_mm": dot_errors,
        "invented": sum(
            got is not None and place is None
            for got, place in zip((dots_found.left, dots_found.right), places, strict=True)
        ),
        "tilt_error_deg": (
            None if measured is None or measured.tilt_deg is None or true_deg is None else measured.tilt_deg - true_deg
        ),
        "tilt_deg": true_deg,
        "cpu_ms": cpu_ms,
    }


def rows_of(
    scenes: int, seed: int, width_px: int, say: Callable[[str, float], None], posed: str = "free",
    name: str | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Measure ``scenes`` random scenes, ``SCENES_PER_RIG`` with each instrument.

    ``posed`` is one of ``POSED``, ``name`` one of the objects.
    """
    light = live_light_of(load_rig(RIG_FILE))
    rows = []
    device = instrument(seed * 1000, width_px)
    for k in range(scenes):
        say("distance", k / scenes)
        if k and k % SCENES_PER_RIG == 0:
            device = instrument(seed * 1000 + k // SCENES_PER_RIG, width_px)
        rng = np.random.default_rng([seed, k, 31])
        case = drawn(rng, name, "guided" in posed)
        if "aimed" in posed:
            case = aimed(case, device.truth, rng, 0.0 if case.scene.motion.still else MOVED_AT_S)
        rows.append(row(device, case, seed * 10_000 + k, light))
    return rows
