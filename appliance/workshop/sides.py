"""The step ``sides``: which of the two cameras is the left one.

Two cameras that are turned inwards see a plane before them differently: the left one is nearer to its left part, and
sees that larger.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from appliance.workshop.finding import finding_of
from appliance.workshop.raster import Orientation, PictureView
from appliance.workshop.step import StepOutcome

SURE = 0.005
"""Smallest difference of the cameras' logarithmic ratios of scale that identifies them."""
_STATEMENTS = {
    None: "left and right are not measurable here: use a flat wall at half a metre, and an upright picture",
    True: "left and right camera are exchanged",
    False: "left and right are as in the rig file",
}


def judge(views: Mapping[str, PictureView]) -> StepOutcome:
    """Judge whether left and right camera are as in the rig file; an unknown result is no fault."""
    is_exchanged = sides_exchanged(views["left"], views["right"])
    limits = "the left camera sees the left part of a plane larger, the right camera the right part"
    remedy = "exchange the serials of [camera.left] and [camera.right] in the rig file"
    ratios = {f"{side}_ratio": view.scale_ratio for side, view in views.items()}
    return StepOutcome((finding_of("sides", not is_exchanged, _STATEMENTS[is_exchanged], limits, remedy, **ratios),))


def sides_exchanged(left: PictureView, right: PictureView) -> bool | None:
    """Return True if left and right camera are exchanged; ``None`` if it cannot be determined.

    A picture that both see mirrored counts as mirrored by the projector, as cameras mirror only where they are set to.
    One that is turned by 180° may be turned by either.
    """
    if left.scale_ratio is None or right.scale_ratio is None or left.orientation is not right.orientation:
        return None
    # The ratio of both ratios, since an oblique plane changes those of both cameras alike.
    difference = math.log(left.scale_ratio / right.scale_ratio)
    if left.orientation is Orientation.TURNED:
        return None
    if left.orientation is Orientation.MIRRORED:
        # The left part of the picture lies on the right of the wall.
        difference = -difference
    return None if abs(difference) < SURE else difference < 0.0
