"""Owns the step ``sides``: which of the two cameras is the left one.

Of two cameras that are turned inwards the left one is nearer to the left part of what lies before them, and sees it
larger.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from appliance.workshop.finding import judged
from appliance.workshop.raster import Orientation, SeenPicture
from appliance.workshop.step import StepOutcome

SURE = 0.005
"""Least difference of the cameras' logarithmic ratios of scale from which they are told apart."""
_SAID = {
    None: "which camera is left cannot be told here: take a flat wall at half a metre, and a picture that is not turned",
    True: "left and right camera are exchanged",
    False: "left and right are as in the rig file",
}


def judge(seen: Mapping[str, SeenPicture]) -> StepOutcome:
    """Judge whether left and right camera are as in the rig file; where it cannot be told, that is no fault."""
    found = exchanged(seen["left"], seen["right"])
    limits = "the left camera sees the left part of a plane larger, the right camera the right part"
    remedy = "exchange the serials of [camera.left] and [camera.right] in the rig file"
    ratios = {f"{side}_ratio": one.scale_ratio for side, one in seen.items()}
    return StepOutcome((judged("sides", not found, _SAID[found], limits, remedy, **ratios),))


def exchanged(left: SeenPicture, right: SeenPicture) -> bool | None:
    """Return whether left and right camera are exchanged; ``None``: it cannot be told.

    A picture that both see mirrored is taken for mirrored by the projector, as cameras mirror only where they are told
    to. One that is turned by 180° may be turned by either.
    """
    if left.scale_ratio is None or right.scale_ratio is None or left.orientation is not right.orientation:
        return None
    # Of two ratios, since a plane that stands askew changes both cameras' alike.
    difference = math.log(left.scale_ratio / right.scale_ratio)
    if left.orientation is Orientation.TURNED:
        return None
    if left.orientation is Orientation.MIRRORED:
        # What is left in the picture lies right on the wall.
        difference = -difference
    return None if abs(difference) < SURE else difference < 0.0
