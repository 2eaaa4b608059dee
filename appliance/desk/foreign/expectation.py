"""Owns how well a description explains its images: each is predicted from the coordinates that all of them make, and compared.

Coordinates are smoothed first: those of a wrong order are noise, and predict nothing. The share of an image's variation that its
prediction explains is near 1 where the description is right, near 0 where an image shows something else, and near 0, too, for
stripes that the camera does not resolve: these vary little, and weigh so much less.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.appearance import share_of_range
from appliance.desk.foreign.camera import DecodedCamera
from appliance.desk.foreign.description import AxisConvention, Description
from appliance.desk.foreign.order import ShownImage, Shows
from appliance.desk.foreign.phase import Floats

SMOOTHED_PX = 5
LEAST_PIXELS = 500
NOWHERE = -1e6


def explained_shares(
    description: Description, camera: DecodedCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each image the share of its variation that is explained, 1 at most, and the weight it has (n,)."""
    shares, lit = share_of_range(np.stack(list(camera.images.images)))
    smooth = {axis.name: _smoothed(camera.placed[axis.name].coordinate_px, lit) for axis in description.axes}
    explained, weights = np.zeros(len(shares)), np.zeros(len(shares))
    for k, one in enumerate(camera.images.shown):
        axis = description.axis(one.axis)
        if axis is None:
            seen = shares[k][lit] - 0.5
            expected = np.full_like(seen, 0.5 if one.shows is Shows.BRIGHT else -0.5)
            weights[k] = 0.25
        else:
            coordinate_px, usable = smooth[axis.name]
            modulated = one.shows is Shows.MODULATED
            # Of one that a carrier multiplies, the mean over the carrier's steps.
            steps = axis.carriers[one.period] if modulated else 1
            first = k - one.index % steps
            seen = shares[first : first + steps, usable].mean(axis=0)
            seen = seen - (seen.mean() if modulated else np.float32(0.5))
            if len(seen) < LEAST_PIXELS:
                continue
            expected = expected_values(axis, one, coordinate_px[usable] + 0.5)
            # Blur takes contrast from stripes and sines, and explains nothing away.
            contrast = max(0.0, float(expected @ seen) / max(float(expected @ expected), 1e-9))
            expected = contrast * expected
            weights[k] = float(np.mean(np.square(seen)))
        explained[k] = 1.0 - float(np.mean(np.square(seen - expected))) / max(float(np.mean(np.square(seen))), 1e-9)
    return explained, weights


def expected_values(axis: AxisConvention, one: ShownImage, edge_px: NDArray[Any]) -> NDArray[Any]:
    """Return what an image of ``axis`` shows at places ``edge_px`` from the edge of the pattern, −½ … ½."""
    if one.shows in (Shows.GRAY, Shows.INVERSE):
        number = np.floor((edge_px - axis.code_offset_px) / axis.stripe_px).astype(np.int64)
        digit = one.index if axis.fine_first else axis.bits - 1 - one.index
        bit = ((number if axis.plain_binary else number ^ (number >> 1)) >> digit) & 1
        return (bit - 0.5) * (-1.0 if axis.inverted != (one.shows is Shows.INVERSE) else 1.0)
    period, step = one.period, one.index
    if one.shows is Shows.MICRO:
        period, step = [(k, n) for k, steps in enumerate(axis.steps_deg) for n in range(len(steps))][one.index]
    elif one.shows is Shows.MODULATED:
        step = one.index // axis.carriers[period]
    turns = edge_px / axis.periods_px[period] + (axis.begins_deg[period] + axis.signed_deg[period][step]) / 360.0
    return np.asarray(0.5 * np.cos(2.0 * np.pi * turns))


def _smoothed(coordinate_px: Floats, lit: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    known = np.isfinite(coordinate_px)
    # A median needs all of its neighbours, or the border of the thing itself would count as an error.
    whole = cv2.erode(known.astype(np.uint8), np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8)) > 0
    filled = np.where(known, coordinate_px, NOWHERE).astype(np.float32)
    return np.asarray(cv2.medianBlur(filled, SMOOTHED_PX)), whole & lit
