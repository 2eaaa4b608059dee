"""Instruments with laser pointers that are learned from rendered live images, and where their beams truly end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.ranger import Ranger
from appliance.instrument.service.settings import live_light_of, pointers_of
from appliance.store.config import load_rig
from hw_sim.optics.view import Surface
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, project
from tests.support.truth import WATER, complete_calibration, rig_to_left

Array = NDArray[np.float64]

RIG_FILE = Path("hw_sim/rigs/full.toml")
TEACHING = tuple(
    Scene(object="plane", pose=(0.0, 0.0, z, 5.0, -8.0, 0.0), texture="slight") for z in (420.0, 470.0, 520.0, 570.0)
)
"""What an instrument has seen before: its beams are learned from it."""
EXPOSURE_S = 0.012
BEAM_SIGMA_MM = 0.9
"""Standard deviation of a beam's light across it (``docs/protocols/world.md``)."""


@dataclass(frozen=True, slots=True)
class Instrument:
    """A rig with its calibration, as it starts and as it has learned."""

    truth: TrueRig
    ranger: Ranger


def instrument(seed: int, width_px: int, taught: bool = True) -> Instrument:
    """A realistic rig with a perfect calibration; ``taught``: after some planes, else as drawn."""
    rig = load_rig(RIG_FILE)
    pointers = pointers_of(rig)
    assert pointers is not None
    truth = draw_truth("realistic", seed, width_px, width_px * 3 // 4, TEACHING[0].water.index)
    ranger = Ranger(complete_calibration(truth).rig, WATER.index, pointers.beams())
    if taught:
        light = live_light_of(rig)
        for k, scene in enumerate(TEACHING):
            ranger.measure(live_pair(Renderer(truth, scene), (True, True), seed * 100 + k, light))
    return Instrument(truth, ranger)


def truth_of(one: Instrument, dots: list[NDArray[np.float64] | None]) -> tuple[float | None, float | None]:
    """True distance and tilt in the frame of the calibration, from those dots that are seen."""
    frame = one.ranger.frame
    places = [frame.from_left(rig_to_left(one.truth, dot[None])[0]) if dot is not None else None for dot in dots]
    here = [place for place in places if place is not None]
    if not here:
        return None, None
    if len(here) == 1:
        return float(here[0][2]), None
    a, b = here
    across, behind = float(b[0] - a[0]), float(b[2] - a[2])
    share = -float(a[0]) / across
    return float(a[2]) + share * behind, math.degrees(math.atan2(behind, across))


def true_dots(renderer: Renderer, truth: TrueRig, time_s: float) -> list[Array | None]:
    """Where the beams meet the object, rig frame of the truth; where an edge cuts a beam whose axis passes by, the middle of
    the light that the object gets of it. ``None``: it gets none."""
    return [_lit(renderer, np.array(laser.origin_mm), np.array(laser.direction), time_s) for laser in truth.lasers]


def _lit(renderer: Renderer, start: Array, beam: Array, time_s: float) -> Array | None:
    x = np.cross([0.0, 1.0, 0.0], beam)
    x /= np.linalg.norm(x)
    y, surface, places, weights = np.cross(beam, x), renderer.surface(time_s), [], []
    for radius in BEAM_SIGMA_MM * np.arange(0.0, 2.6, 0.5):
        for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 6.0) if radius else (0.0,):
            at = start + radius * (np.cos(angle) * x + np.sin(angle) * y)
            along_mm = _met(surface, at, beam)
            if along_mm is None:
                continue
            if not radius:
                return np.asarray(at + along_mm * beam)
            places.append(at + along_mm * beam)
            weights.append(radius * np.exp(-0.5 * (radius / BEAM_SIGMA_MM) ** 2))
    return np.average(places, axis=0, weights=weights) if places else None


def _met(surface: Surface, start: Array, beam: Array) -> float | None:
    """How far light goes until it meets the surface, mm."""
    coarse = np.arange(250.0, 800.0, 1.0)
    inside = np.flatnonzero(surface.distance_mm(start + coarse[:, None] * beam) < 0.0)
    if not len(inside):
        return None
    fine = coarse[inside[0]] + np.arange(-1.0, 0.01, 0.02)
    return float(fine[np.argmax(surface.distance_mm(start + fine[:, None] * beam) < 0.0)])


def live_pair(
    renderer: Renderer, lasers: tuple[bool, bool], seed: int, light: NDArray[np.uint8], time_s: float = 0.0,
    exposure_s: float = EXPOSURE_S,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:  # fmt: skip
    """Both cameras' images in the live light."""
    left, right = (
        renderer.expose(side, [LightSlice(light, exposure_s)], time_s, exposure_s, 0.0, lasers, 2 * seed + number)
        for number, side in enumerate(("left", "right"))
    )
    return left, right


def hide(image: NDArray[np.uint8], truth: TrueRig, side: str, dot: Array) -> NDArray[np.uint8]:
    """The image with a dark weed before the dot."""
    u, v = project(truth, side, dot[None])[0]
    radius = round(0.035 * image.shape[1])
    return np.asarray(cv2.circle(image.copy(), (round(float(u)), round(float(v))), radius, 12, -1), np.uint8)
