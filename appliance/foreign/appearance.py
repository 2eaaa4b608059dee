"""Owns what each image of a sequence looks like: even, a code or a sine, along which direction, and whether it is the one before inverted.

What is looked at, of each pixel over the whole sequence: an image of a code is near the pixel's darkest or brightest value, a sine
is often between; stripes of X change along the rows and those of Y along the columns. Stripes finer than the camera's pixels look like
neither; where each image is followed by its inverse, the images before them tell what they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.problem import ForeignError

LINES = 48
"""Lines across, and down, of which each image's changes are counted."""
LEAST_RANGE = 0.15
"""Least swing of a pixel that is asked, over that of the liveliest ones."""
LEAST_PIXELS = 1000
BETWEEN = (0.2, 0.8)
SINE_BETWEEN = 0.2
"""Share of the pixels between a fifth and four fifths of their range from which on an image is a sine: 0.41 are expected of one, 0.03 of fine stripes."""
EVEN, EVEN_SPREAD = 0.1, 0.15
"""An image whose pixels are nearer to their ends than this, on an average, is bright or dark all over; four fifths of them lie within
the second number, or it is a part of a wide fringe."""
INVERSE = 0.35
"""Two images are each other's inverses where their sum varies less than so much of their difference, root mean squares."""
LEAST_PAIRS = 4
"""Number of such pairs, one behind the other, from which on a sequence is one of images with their inverses."""
QUADRATURE = -0.6
"""Correlation of the squares of two differences below which they are cosine and sine of one fringe."""
LEAST_SINES = 3
MOST_FINE, ALIKE = 4, 1.6
"""Most images of a code that are too fine to look like one, and the ratio of their changes from which on they are no steps."""


@dataclass(frozen=True, slots=True)
class Seen:
    """Appearance of one image."""

    word: str
    """The image in the words of a description, but for the number of its period."""
    changes: float
    """Changes from dark to bright or back, over all lines."""


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """One image by itself."""

    kind: str
    """``bright``, ``dark``, ``gray`` or ``sine``."""
    axis: str
    changes: float
    values: NDArray[np.float32]
    """(n,): pixels along some lines across and down, −½ at their darkest and ½ at their brightest."""

    @property
    def even(self) -> bool:
        """True if it shows the same everywhere."""
        return self.kind in ("bright", "dark")


def looked_at(images: NDArray[Any]) -> list[Seen]:
    """Return the appearance of ``images`` (n, h, w). Raises ForeignError where they hardly differ."""
    looks = _looks(images)
    begin, pairs = _pairs(looks)
    if pairs < LEAST_PAIRS:
        apart = _pairs_apart(looks)
        if apart:
            return _one_of_each(_apart(looks, apart))
        return _one_of_each(_single(looks))
    inside = looks[begin : begin + 2 * pairs]
    words = _paired(inside)
    around = [Seen(_word(look), look.changes) for look in looks]
    said = [Seen(word, look.changes) for word, look in zip(words, inside, strict=True)]
    return _one_of_each([*around[:begin], *said, *around[begin + 2 * pairs :]])


def _looks(images: NDArray[Any]) -> list[_Look]:
    low, high = images.min(axis=0).astype(np.float32), images.max(axis=0).astype(np.float32)
    swing = high - low
    usable = swing > max(LEAST_RANGE * float(np.quantile(swing, 0.98)), 4.0)
    if np.count_nonzero(usable) < LEAST_PIXELS:
        raise ForeignError(
            f"the images hardly differ: {np.count_nonzero(usable)} pixels change; give a folder with a whole sequence"
        )
    height, width = swing.shape
    across, down = slice(None, None, max(1, height // LINES)), slice(None, None, max(1, width // LINES))
    rows, columns = usable[across], usable.T[down]
    looks = []
    for image in images:
        share = (image.astype(np.float32) - low) / np.maximum(swing, np.float32(1.0))
        along_x, along_y = share[across], share.T[down]
        # Lines both ways: those of one way alone meet stripes of the other one at few places of a period.
        values = np.concatenate([along_x[rows], along_y[columns]])
        axis = "x" if _gradient(along_x, rows) >= _gradient(along_y, columns) else "y"
        sides = _changes(along_x, rows) * height / LINES, _changes(along_y, columns) * width / LINES
        looks.append(_Look(_kind(values), axis, sides["xy".index(axis)], values - np.float32(0.5)))
    return looks


def _kind(values: NDArray[np.float32]) -> str:
    """Return what an image shows by its pixels' values (n,), 0 at their darkest and 1 at their brightest."""
    mean = float(values.mean())
    low, high = np.quantile(values, (0.1, 0.9))
    if high - low < EVEN_SPREAD and (mean > 1.0 - EVEN or mean < EVEN):
        return "bright" if mean > 0.5 else "dark"
    return "sine" if float(np.mean((values > BETWEEN[0]) & (values < BETWEEN[1]))) > SINE_BETWEEN else "gray"


def _changes(share: NDArray[np.float32], usable: NDArray[np.bool_]) -> float:
    """Return how often lines (n, length) cross the middle, by pixels that are clearly above or below it."""
    clear = usable & (np.abs(share - np.float32(0.5)) > np.float32(0.15))
    count = 0
    for line, known in zip(share > np.float32(0.5), clear, strict=True):
        count += int(np.count_nonzero(np.diff(line[known].astype(np.int8))))
    return float(count)


def _gradient(share: NDArray[np.float32], usable: NDArray[np.bool_]) -> float:
    step = np.abs(np.diff(share, axis=1))
    both = usable[:, 1:] & usable[:, :-1]
    return float(step[both].mean()) if both.any() else 0.0


def _word(look: _Look) -> str:
    return look.kind if look.even else f"{look.kind}-{look.axis}"


def _are_inverse(one: _Look, other: _Look) -> bool:
    total, difference = one.values + other.values, one.values - other.values
    return float(np.sqrt(np.mean(total**2))) < INVERSE * float(np.sqrt(np.mean(difference**2)))


# ------------------------------------------------------------------------------------------ images with inverses


def _pairs(looks: Sequence[_Look]) -> tuple[int, int]:
    """Return the first image of the longest chain of inverse pairs, and how many pairs it has; some of them must be stripes."""
    inverse = [_are_inverse(one, other) for one, other in pairwise(looks)]
    best = 0, 0
    for begin in range(len(inverse)):
        count = 0
        while begin + 2 * count < len(inverse) and inverse[begin + 2 * count]:
            count += 1
        codes = sum(looks[begin + 2 * k].kind == "gray" for k in range(count))
        if count > best[1] and codes >= LEAST_PAIRS - 1:
            best = begin, count
    return best


def _pairs_apart(looks: Sequence[_Look]) -> list[tuple[int, int]]:
    """Return images with their inverses where these follow as a block: all of a direction, or of both; empty where there are none."""
    codes = [k for k, look in enumerate(looks) if look.kind == "gray"]
    found: list[tuple[int, int]] = []
    used: set[int] = set()
    for k in codes:
        if k in used:
            continue
        partner = next((j for j in codes if j > k + 1 and j not in used and _are_inverse(looks[k], looks[j])), None)
        if partner is not None:
            found.append((k, partner))
            used |= {k, partner}
    pairs: list[tuple[int, int]] = []
    for distance in sorted({j - k for k, j in found}):
        # Of one block, all are as far from their inverses; what is not is chance, or one of four steps.
        blocks: list[list[int]] = []
        for k in (k for k, j in found if j - k == distance):
            # A block is as long as its inverses are away; behind them another one may follow.
            if not blocks or k >= blocks[-1][0] + distance:
                blocks.append([])
            blocks[-1].append(k)
        for mine in blocks:
            if len(mine) >= LEAST_PAIRS:
                pairs += [(k, k + distance) for k in _whole_block(looks, mine, distance)]
    return sorted(pairs)


def _whole_block(looks: Sequence[_Look], mine: Sequence[int], distance: int) -> range:
    """Return the images of a block with inverses: also those at its fine end, which the camera cannot resolve, and even ones at its coarse
    end, where it sees half of the pattern."""
    first, last = min(mine), max(mine)
    for _ in range(2):
        if first > 0 and looks[first - 1].even and _are_inverse(looks[first - 1], looks[first - 1 + distance]):
            first -= 1
        if (
            last + 1 + distance < len(looks)
            and looks[last + 1].even
            and _are_inverse(looks[last + 1], looks[last + 1 + distance])
        ):
            last += 1
    if looks[max(mine)].changes > looks[min(mine)].changes:
        return range(first, max(last + 1, min(first + distance, len(looks) - distance)))
    return range(min(first, max(0, last + 1 - distance)), last + 1)


def _apart(looks: Sequence[_Look], pairs: Sequence[tuple[int, int]]) -> list[Seen]:
    """Return what images show of which some have inverses elsewhere: those as if they stood side by side."""
    seen = _single(looks)
    words = _paired([looks[k] for pair in pairs for k in pair])
    for k, word in zip((k for pair in pairs for k in pair), words, strict=True):
        seen[k] = Seen(word, looks[k].changes)
    return seen


def _paired(looks: Sequence[_Look]) -> list[str]:
    """Return the words of images that come with their inverses, two by two."""
    pairs = [(looks[k], looks[k + 1]) for k in range(0, len(looks), 2)]
    axes = [_axis_of_pair(pairs, k) for k in range(len(pairs))]
    stripes = [k for k, axis in enumerate(axes) if axis]
    # Finest images have the most changes; those that are finer than pixels have few, and so the greatest number counts.
    mine = [k for k in stripes if axes[k] == axes[stripes[0]]]
    fine_first = max(mine, key=lambda k: pairs[k][0].changes) < mine[len(mine) // 2]
    words: list[str] = []
    named = False
    for k, pair in enumerate(pairs):
        axis = axes[k]
        outside = k < stripes[0] or k > stripes[-1]
        if not axis and outside and not named and k in (0, len(pairs) - 1):
            words += [one.kind for one in pair]
            named = True
            continue
        if not axis:
            # The coarsest images are even where a camera sees half of the pattern: their stripes follow, or went before.
            near = next(
                (j for j in (reversed(stripes) if fine_first else stripes) if (j < k if fine_first else j > k)), -1
            )
            axis = axes[near] if near >= 0 else ""
        if axis and _is_fringe(pairs, axes, k):
            words += [f"sine-{axis}"] * 2
        else:
            words += [f"gray-{axis}", f"~gray-{axis}"] if axis else ["-", "-"]
    return words


def _axis_of_pair(pairs: Sequence[tuple[_Look, _Look]], k: int) -> str:
    """Return the direction of a pair, of stripes finer than pixels that of the pair beside it; empty where it is even."""
    look = pairs[k][0]
    if look.even:
        return ""
    if look.kind == "gray":
        return look.axis
    # What lies between dark and bright shows moiré of any direction.
    around = (pairs[j][0] for j in (*range(k - 1, -1, -1), *range(k + 1, len(pairs))))
    return next((other.axis for other in around if other.kind == "gray"), look.axis)


def _is_fringe(pairs: Sequence[tuple[_Look, _Look]], axes: Sequence[str], k: int) -> bool:
    """Tell whether a pair is half of four steps 0°, 180°, 90°, 270°: where one is small, the pair beside it is large."""
    if pairs[k][0].kind != "sine":
        return False
    for j in (k - 1, k + 1):
        if 0 <= j < len(pairs) and pairs[j][0].kind == "sine" and axes[j] == axes[k]:
            first, second = (pairs[i][0].values - pairs[i][1].values for i in (j, k))
            if float(np.corrcoef(first**2, second**2)[0, 1]) < QUADRATURE:
                return True
    return False


# --------------------------------------------------------------------------------------- images without inverses


def _single(looks: Sequence[_Look]) -> list[Seen]:
    """Return images by themselves; one of a code that is the inverse of the one before it is called so."""
    seen: list[Seen] = []
    for k, look in enumerate(looks):
        before = seen[-1].word if seen else ""
        inverse = look.kind == "gray" and before == f"gray-{look.axis}" and _are_inverse(looks[k - 1], look)
        seen.append(Seen(f"{'~' if inverse else ''}{_word(look)}", 0.0 if look.even else look.changes))
    return seen


def _one_of_each(seen: list[Seen]) -> list[Seen]:
    """Return what was seen with one bright and one dark image at most, and inverses everywhere or nowhere."""
    seen = list(seen)
    for kind in ("bright", "dark"):
        places = [k for k, one in enumerate(seen) if one.word == kind]
        for k in places[1:]:
            # A coarsest image is even where a camera sees half of the pattern; its finer ones follow.
            behind = seen[k + 1].word if k + 1 < len(seen) else ""
            seen[k] = Seen(behind if behind.startswith("gray-") else "-", 0.0)
    for axis in "xy":
        sines = [k for k, one in enumerate(seen) if one.word == f"sine-{axis}"]
        if len(sines) < LEAST_SINES and any(one.word == f"gray-{axis}" for one in seen):
            # Too few to be steps: stripes of the code that are hardly wider than a pixel.
            for k in sines:
                seen[k] = replace(seen[k], word=f"gray-{axis}")
        seen = _beside_stripes(seen, axis)
        plain = sum(one.word == f"gray-{axis}" for one in seen)
        inverse = sum(one.word == f"~gray-{axis}" for one in seen)
        if inverse and inverse != plain:
            seen = [
                replace(one, word=one.word.removeprefix("~")) if one.word == f"~gray-{axis}" else one for one in seen
            ]
    return seen


def _beside_stripes(seen: list[Seen], axis: str) -> list[Seen]:
    """Return what was seen with stripes that are hardly wider than a pixel told from sines: they are few, go on where a code ends, and
    change ever more often, while steps of one period change alike."""
    words = [one.word for one in seen]
    begin = 0
    for word, run in groupby(words):
        length = len(list(run))
        end = begin + length
        beside = f"gray-{axis}" in (words[begin - 1] if begin else "", words[end] if end < len(words) else "")
        changes = [one.changes for one in seen[begin:end]]
        if word == f"sine-{axis}" and length <= MOST_FINE and beside and max(changes) > ALIKE * max(min(changes), 1.0):
            seen = [*seen[:begin], *(replace(one, word=f"gray-{axis}") for one in seen[begin:end]), *seen[end:]]
        begin = end
    return seen
