"""Owns what each image of a sequence looks like, and how well that agrees with what it is said to show.

What is looked at, of each pixel over the whole sequence: an image of a code is near the pixel's darkest or brightest
value, a sine is often between; stripes of X change along the rows and those of Y along the columns; an image and its
inverse add up to the same everywhere. Stripes finer than the camera's pixels look like neither, so that no look decides
by itself: looks choose which sequences are tried.
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
"""Least swing of a pixel that is asked, over that of the liveliest ones, and in grey values."""
LEAST_PIXELS = 1000
SAMPLES = 20_000
BETWEEN = (0.2, 0.8)
SINE_BETWEEN = 0.3
"""Share of the pixels between a fifth and four fifths of their range in a clear sine: 0.41 are expected, 0.03 of wide
stripes."""
BLURRED = 0.6
"""Agreement of an image of a code that looks like a sine: fine stripes do."""
WIDE = 0.3
"""Agreement of a sine that looks even, or like stripes: a wide fringe does, of which a part is seen."""
INVERSE = 0.7
"""Ratio of the sum's to the difference's root mean square, from which on two images are no inverses of each other."""
EVEN, ENDS = 0.15, 0.1
"""Images that vary less than the first number and are nearer to an end than the second one show the same everywhere."""


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
    """Logarithm of how much it changes from pixel to pixel."""


def share_of_range(images: NDArray[Any]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the ``images`` (n, h, w), 0 where a pixel is darkest and 1 where it is brightest, and the pixels (h, w)
    that change.

    Raises ForeignError where hardly any does.
    """
    low, high = images.min(axis=0).astype(np.float32), images.max(axis=0).astype(np.float32)
    swing = high - low
    lit = swing > max(LEAST_RANGE * float(np.quantile(swing, 0.98)), LEAST_DN)
    if np.count_nonzero(lit) < LEAST_PIXELS:
        raise ForeignError(
            f"the images hardly differ: {np.count_nonzero(lit)} pixels change; give a folder with a whole sequence"
        )
    shares = images.astype(np.float32)
    shares -= low
    shares /= np.maximum(swing, np.float32(1.0))
    return shares, lit


def look_at(images: NDArray[Any]) -> Looks:
    """Return the appearance of ``images`` (n, h, w). Raises ForeignError where they hardly differ."""
    shares, lit = share_of_range(images)
    values = shares[:, lit]
    across, down = (np.array([_change(one, lit) for one in turned]) for turned in (shares, shares.transpose(0, 2, 1)))
    # Images are compared with each other: some thousand pixels are enough for that.
    few = values[:, :: max(1, values.shape[1] // SAMPLES)] - np.float32(0.5)
    between = np.mean((values > BETWEEN[0]) & (values < BETWEEN[1]), axis=1)
    along_x = (across - down) / np.maximum(across + down, 1e-6)
    return Looks(
        few,
        values.mean(axis=1),
        values.std(axis=1),
        between,
        along_x,
        np.log(np.maximum(np.maximum(across, down), 1e-4)),
    )


def _change(share: Floats, lit: NDArray[np.bool_]) -> float:
    """Return the mean change of an image from a pixel to the next along its last dimension."""
    if share.shape != lit.shape:
        lit = lit.T
    both = lit[:, 1:] & lit[:, :-1]
    return float(np.abs(np.diff(share, axis=1))[both].mean()) if both.any() else 0.0


def are_inverse(looks: Looks, one: int, other: int) -> float:
    """Return how far two images are each other's inverses, 0 … 1."""
    total, difference = looks.values[one] + looks.values[other], looks.values[one] - looks.values[other]
    ratio = float(np.sqrt(np.mean(np.square(total)) / max(float(np.mean(np.square(difference))), 1e-6)))
    return max(0.0, 1.0 - ratio / INVERSE)


def agreement(looks: Looks, shown: Sequence[ShownImage]) -> float:
    """Return how well the looks agree with what images are said to show, 0 … 1."""
    places = {one: k for k, one in enumerate(shown)}
    agreed = []
    for k, one in enumerate(shown):
        sine_like = min(1.0, float(looks.between[k]) / SINE_BETWEEN)
        along = float(looks.along_x[k]) * (-1.0 if one.axis == "y" else 1.0)
        varies = one.axis and one.shows is not Shows.MODULATED  # that varies both ways
        axis = 0.5 + 0.5 * np.clip(3.0 * along, -1.0, 1.0) if varies else 1.0
        match one.shows:
            case Shows.BRIGHT | Shows.DARK:
                off = looks.mean[k] if one.shows is Shows.DARK else 1.0 - looks.mean[k]
                agreed.append(1.0 - float(off))
            case Shows.INVERSE:
                agreed.append(are_inverse(looks, places[ShownImage(Shows.GRAY, one.axis, one.index)], k))
            case Shows.GRAY:
                agreed.append(axis * (1.0 - (1.0 - BLURRED) * sine_like))
            case _ if one.shows in FRINGES:
                alike = [
                    j
                    for j, other in enumerate(shown)
                    if (other.shows, other.axis, other.period) == (one.shows, one.axis, one.period)
                ]
                # All steps of one period change as often.
                off = (
                    abs(float(looks.fineness[k] - np.median(looks.fineness[alike]))) if one.shows is Shows.SINE else 0.0
                )
                agreed.append(axis * (WIDE + (1.0 - WIDE) * sine_like) * float(np.exp(-2.0 * off)))
            case _:
                agreed.append(0.5)
    return float(np.mean(agreed))


def words_by_looks(looks: Looks) -> list[str]:
    """Return what each image seems to show by itself, in the words of a description."""
    words: list[str] = []
    for k in range(len(looks.mean)):
        axis = "x" if looks.along_x[k] >= 0.0 else "y"
        if looks.spread[k] < EVEN and min(looks.mean[k], 1.0 - looks.mean[k]) < ENDS:
            words.append("bright" if looks.mean[k] > 0.5 else "dark")
        elif looks.between[k] > 0.5 * SINE_BETWEEN:
            words.append(f"sine-{axis}")
        elif words and words[-1] == f"gray-{axis}" and are_inverse(looks, k - 1, k) > 0.5:
            words.append(f"~gray-{axis}")
        else:
            words.append(f"gray-{axis}")
    return [word if word not in ("bright", "dark") or word not in words[:k] else "-" for k, word in enumerate(words)]
