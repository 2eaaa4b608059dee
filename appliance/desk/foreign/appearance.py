"""Appearance of each image of a sequence, and its agreement with a role.

The features are of each pixel over the whole sequence: an image of a code is near the pixel's darkest or brightest
value, a sine is often between; stripes of X change along the rows and those of Y along the columns; an image and its
inverse add up to the same everywhere. Stripes finer than the camera's pixels have neither feature, so appearance alone
decides no role: it selects the sequences that are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.order import FRINGES, ShownImage, Shows
from appliance.desk.foreign.problem import ForeignError

Floats = NDArray[np.float32]

LEAST_RANGE, LEAST_DN = 0.15, 4.0
"""Least swing of a pixel that counts, over that of the pixels with most, and in grey values."""
LEAST_PIXELS = 1000
SAMPLES = 20_000
BETWEEN = (0.2, 0.8)
SINE_BETWEEN = 0.3
"""Share of the pixels between a fifth and four fifths of their range in a clear sine: 0.41 are expected, and 0.03 for
wide stripes."""
BLURRED = 0.6
"""Agreement of an image of a code that resembles a sine, as fine stripes do."""
WIDE = 0.3
"""Agreement of a sine that resembles an even image or stripes, as a part of a wide fringe does."""
INVERSE = 0.7
"""Ratio of the root mean squares of sum and difference from which two images are no inverses of each other."""
EVEN, ENDS = 0.15, 0.1
"""An image is even if it varies less than the first number and its mean is nearer to an end than the second."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """Appearance of the images of a sequence, each (n,)."""

    values: Floats
    """(n, pixels): −½ where a pixel is darkest, ½ where it is brightest."""
    mean: Floats
    """Mean of them, 0 … 1."""
    spread: Floats
    between: Floats
    along_x: Floats
    """Change of an image along its rows less that along its columns, over their sum: −1 … 1."""
    fineness: Floats
    """Logarithm of the mean change from pixel to pixel."""


def share_of_range(images: NDArray[Any]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the ``images`` (n, h, w), scaled to the range of each pixel, and the pixels that change.

    A pixel is 0 where it is darkest and 1 where it is brightest; the second result is (h, w). Raises ForeignError if hardly
    any pixel changes.
    """
    low, high = images.min(axis=0).astype(np.float32), images.max(axis=0).astype(np.float32)
    swing = high - low
    changes = swing > max(LEAST_RANGE * float(np.quantile(swing, 0.98)), LEAST_DN)
    if np.count_nonzero(changes) < LEAST_PIXELS:
        raise ForeignError(
            f"the images hardly differ: {np.count_nonzero(changes)} pixels change; give a folder with a whole sequence"
        )
    shares = images.astype(np.float32)
    shares -= low
    shares /= np.maximum(swing, np.float32(1.0))
    return shares, changes


def look_at(images: NDArray[Any]) -> Looks:
    """Return the appearance of ``images`` (n, h, w). Raises ForeignError if they hardly differ."""
    shares, illuminated = share_of_range(images)
    values = shares[:, illuminated]
    across, down = (
        np.array([_change(image, illuminated) for image in oriented])
        for oriented in (shares, shares.transpose(0, 2, 1))
    )
    # Some thousand pixels are enough to compare images with each other.
    samples = values[:, :: max(1, values.shape[1] // SAMPLES)] - np.float32(0.5)
    between = np.mean((values > BETWEEN[0]) & (values < BETWEEN[1]), axis=1)
    along_x = (across - down) / np.maximum(across + down, 1e-6)
    return Looks(
        samples,
        values.mean(axis=1),
        values.std(axis=1),
        between,
        along_x,
        np.log(np.maximum(np.maximum(across, down), 1e-4)),
    )


def _change(share: Floats, illuminated: NDArray[np.bool_]) -> float:
    """Return the mean change of an image from a pixel to the next along its last dimension."""
    if share.shape != illuminated.shape:
        illuminated = illuminated.T
    neighbours = illuminated[:, 1:] & illuminated[:, :-1]
    return float(np.abs(np.diff(share, axis=1))[neighbours].mean()) if neighbours.any() else 0.0


def are_inverse(looks: Looks, first: int, second: int) -> float:
    """Return how far the images of indices ``first`` and ``second`` are inverses of each other, 0 … 1."""
    total, difference = looks.values[first] + looks.values[second], looks.values[first] - looks.values[second]
    ratio = float(np.sqrt(np.mean(np.square(total)) / max(float(np.mean(np.square(difference))), 1e-6)))
    return max(0.0, 1.0 - ratio / INVERSE)


def agreement(looks: Looks, shown: Sequence[ShownImage]) -> float:
    """Return the agreement of the appearance with the roles ``shown``, 0 … 1."""
    indices = {role: k for k, role in enumerate(shown)}
    agreements = []
    for k, role in enumerate(shown):
        sine_like = min(1.0, float(looks.between[k]) / SINE_BETWEEN)
        along = float(looks.along_x[k]) * (-1.0 if role.axis == "y" else 1.0)
        varies = role.axis and role.shows is not Shows.MODULATED  # that varies both ways
        axis = 0.5 + 0.5 * np.clip(3.0 * along, -1.0, 1.0) if varies else 1.0
        match role.shows:
            case Shows.BRIGHT | Shows.DARK:
                off = looks.mean[k] if role.shows is Shows.DARK else 1.0 - looks.mean[k]
                agreements.append(1.0 - float(off))
            case Shows.INVERSE:
                agreements.append(are_inverse(looks, indices[ShownImage(Shows.GRAY, role.axis, role.index)], k))
            case Shows.GRAY:
                agreements.append(axis * (1.0 - (1.0 - BLURRED) * sine_like))
            case _ if role.shows in FRINGES:
                alike = [
                    j
                    for j, candidate in enumerate(shown)
                    if (candidate.shows, candidate.axis, candidate.period) == (role.shows, role.axis, role.period)
                ]
                # All steps of one period have one fineness.
                off = (
                    abs(float(looks.fineness[k] - np.median(looks.fineness[alike])))
                    if role.shows is Shows.SINE
                    else 0.0
                )
                agreements.append(axis * (WIDE + (1.0 - WIDE) * sine_like) * float(np.exp(-2.0 * off)))
            case _:
                agreements.append(0.5)
    return float(np.mean(agreements))


def words_by_looks(looks: Looks) -> list[str]:
    """Return the role that each image by itself seems to have, in the words of a description."""
    roles: list[str] = []
    for k in range(len(looks.mean)):
        axis = "x" if looks.along_x[k] >= 0.0 else "y"
        if looks.spread[k] < EVEN and min(looks.mean[k], 1.0 - looks.mean[k]) < ENDS:
            roles.append("bright" if looks.mean[k] > 0.5 else "dark")
        elif looks.between[k] > 0.5 * SINE_BETWEEN:
            roles.append(f"sine-{axis}")
        elif roles and roles[-1] == f"gray-{axis}" and are_inverse(looks, k - 1, k) > 0.5:
            roles.append(f"~gray-{axis}")
        else:
            roles.append(f"gray-{axis}")
    return [word if word not in ("bright", "dark") or word not in roles[:k] else "-" for k, word in enumerate(roles)]
