"""Owns the test of which camera is which: left and right exchanged, or R and T written the other way round.

Of a camera and a projector also: where the code begins on it.
Points are made of every so many pixels, as described and otherwise. With two directions, rays of true pairs meet only as the cameras
really stand. With one direction they meet whatever is said, and only where they meet, before the cameras or nowhere, tells
anything: cameras that look towards each other find a mirrored world as well, which nothing here can tell from the true one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from appliance.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.foreign.camera import DecodedCamera, placed_again
from appliance.foreign.cameras import ForeignRig, inverted
from appliance.foreign.decode import PlacedAxis
from appliance.foreign.description import Description
from appliance.foreign.images import ImageSet
from appliance.foreign.points import find_points
from appliance.foreign.problem import ForeignError
from appliance.optics.model import HousedCamera, StereoRig

COARSE_WIDTH_PX = 160
GOOD, POOR = 0.4, 0.25
"""Share of the left pixels with coordinates that have a point: an arrangement with so many is right, one with fewer is doubtful."""
CLEARLY = 2.0
"""Another arrangement is named where it has so many times as many points."""
NAME = "arrangement of the cameras"


@dataclass(frozen=True, slots=True)
class _Tried:
    share: float
    text: str
    instead: Mapping[str, Any] = field(default_factory=dict)


def examine_arrangement(
    description: Description, rig: ForeignRig, cameras: Mapping[str, DecodedCamera]
) -> ExaminedAssumption:  # fmt: skip
    """Test how the cameras stand; ``cameras`` are ``left`` and, unless the right one is a projector, ``right``."""
    coarse_rig, coarse = _coarse(rig, cameras)
    left, right = coarse["left"], coarse.get("right")
    here = _share(description, coarse_rig, left, right)
    turned = replace(coarse_rig, rig=inverted(coarse_rig.rig))
    others = [
        _Tried(
            _share(description, turned, left, right),
            "rotation and translation are those of the other camera (R and T of right to left)",
        )
    ]
    # Exchanged images fit other lenses only where they have the same size.
    if right is not None and left.grey.shape == right.grey.shape:
        text = "left and right are exchanged: name the images of one for the other"
        others.append(_Tried(_share(description, coarse_rig, right, left), text))
    for text, other in _centred(description) if right is None else []:
        placed = _coarse(rig, {"left": placed_again(cameras["left"], other)})[1]["left"]
        instead = {f"{axis.name}.code_offset_px": axis.code_offset_px for axis in other.axes}
        others.append(_Tried(_share(other, coarse_rig, placed, None), text, instead))
    best = max(others, key=lambda one: one.share)
    if best.share > max(CLEARLY * here, POOR):
        return ExaminedAssumption(
            NAME, Outcome.WRONG,
            f"{100 * here:.0f} % of the left pixels have a point, and {100 * best.share:.0f} % if {best.text}", best.instead,
        )  # fmt: skip
    if here < POOR:
        return ExaminedAssumption(
            NAME, Outcome.NOT_JUDGED if here > 0.02 else Outcome.WRONG,
            f"only {100 * here:.0f} % of the left pixels have a point, and no more with left and right or R and T exchanged: check the "
            "cameras' numbers, cameras.unit, water and ports, and range",
        )  # fmt: skip
    if best.share > here / CLEARLY:
        return ExaminedAssumption(
            NAME, Outcome.NOT_JUDGED,
            f"{100 * here:.0f} % of the left pixels have a point, and {100 * best.share:.0f} % if {best.text}: one direction cannot tell"
            if description.one_direction
            else f"{100 * here:.0f} % of the left pixels have a point, and {100 * best.share:.0f} % if {best.text}",
        )  # fmt: skip
    return ExaminedAssumption(
        NAME, Outcome.FITS,
        f"{100 * here:.0f} % of the left pixels have a point; {100 * best.share:.0f} % if {best.text.partition(':')[0]}",
    )  # fmt: skip


def _centred(description: Description) -> list[tuple[str, Description]]:
    """Return the description with codes that begin elsewhere: of 2ⁿ stripes on a projector of fewer px, programs use the first ones or
    those in the middle."""
    found = []
    choices = []
    for axis in description.axes:
        beyond_px = axis.stripe_px * 2**axis.bits - axis.size_px if axis.bits else 0.0
        choices.append(
            [axis.code_offset_px] + ([0.0 if axis.code_offset_px else -0.5 * beyond_px] if beyond_px > 0.0 else [])
        )
    for offsets in list(product(*choices))[1:]:
        other = description
        said = []
        for axis, offset_px in zip(description.axes, offsets, strict=True):
            other = other.with_axis(replace(axis, code_offset_px=offset_px))
            if offset_px != axis.code_offset_px:
                said.append(f"{axis.name}.code_offset_px = {offset_px:g}")
        found.append((" and ".join(said), other))
    return found


def _share(description: Description, rig: ForeignRig, left: DecodedCamera, right: DecodedCamera | None) -> float:
    try:
        found = find_points(description, rig, left, right)
    except ForeignError:  # no depths, no curves, no coordinates: no points
        return 0.0
    return found.points / found.lit if found.lit else 0.0


def _coarse(rig: ForeignRig, cameras: Mapping[str, DecodedCamera]) -> tuple[ForeignRig, dict[str, DecodedCamera]]:
    """Return every so many pixels of the cameras, and the lenses that see them so."""
    step = max(1, rig.rig.left.width_px // COARSE_WIDTH_PX)
    thin = StereoRig(
        _thinned(rig.rig.left, step), rig.rig.right if "right" not in cameras else _thinned(rig.rig.right, step)
    )
    return replace(rig, rig=thin), {side: _thin_camera(camera, step) for side, camera in cameras.items()}


def _thinned(camera: HousedCamera, step: int) -> HousedCamera:
    fu, fv = camera.lens.f_px
    cu, cv = camera.lens.c_px
    lens = replace(camera.lens, f_px=(fu / step, fv / step), c_px=(cu / step, cv / step))
    # Corrections of an image are worth hundredths of a pixel: too little to tell one arrangement from another.
    return replace(
        camera,
        width_px=-(-camera.width_px // step),
        height_px=-(-camera.height_px // step),
        lens=lens,
        correction=None,
        ray_shift=None,
    )


def _thin_camera(camera: DecodedCamera, step: int) -> DecodedCamera:
    at = (slice(None, None, step), slice(None, None, step))
    images = camera.images
    few = ImageSet(images.shown[:1], images.files[:1], images.images[0][None, ::step, ::step], images.white)
    placed = {
        name: PlacedAxis(
            np.ascontiguousarray(one.coordinate_px[at]), one.reason[at], np.ascontiguousarray(one.modulation[at])
        )
        for name, one in camera.placed.items()
    }
    return DecodedCamera(few, {}, placed, np.ascontiguousarray(camera.grey[at]))
