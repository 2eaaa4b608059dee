"""Images of six foreign conventions by the simulator: completeness and accuracy of points, and detection of wrong
descriptions."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from appliance.base import silent
from appliance.desk.foreign.folder import describe_guess
from appliance.desk.foreign.guess import guess_sequence
from appliance.desk.foreign.importing import read_foreign
from appliance.desk.foreign.points import ForeignScan, find_points
from appliance.desk.foreign.problem import ForeignError
from bench.result import Measurement
from tests.support.foreign_sets import CONVENTIONS, Convention, ForeignSet, make_set
from tests.support.truth import left_to_rig

WIDTH_PX, HALF_WIDTH_PX = 800, 400
OUTLIER_MM = 1.0
LEAST_PERCENT, LEAST_COARSE_PERCENT = 97.0, 95.0
"""Share of the pixels that all eyes see: at 800 px, a ring of one to two pixels about each edge is 1 % to 3 % of them. Of stripes alone the
ends of each surface, half a stripe, are drawn from one side only, and their points rejected."""
MOST_PIXELS = 0.1
"""Largest median distance from the surface, in pixels of disparity, for a calibration as good as this one's."""
NORMAL_MEDIAN = 0.6745
MOST_OF_NOISE = 2.0
"""Limit of the median distance over that of normal noise of the stated sigma; above 1, because phases of three steps
also have projector ripple."""
MOST_OF_STRIPES = 1.3
"""The same limit for stripes alone, whose stated sigma is that of their borders."""
MOST_OUTLIERS_PPM = 500.0
WRONG: tuple[tuple[str, str, str], ...] = (
    ("eight-steps", 'sign = "-"', 'sign = "+"'),
    ("eight-steps", "start_deg = 180", "start_deg = 0"),
    ("eight-steps", 'gray = "complementary"', 'gray = "ordinary"'),
    ("half-off", "code_offset_px = -32", "code_offset_px = 0"),
    ("half-off", "steps = 4", "steps_deg = [0, 180, 90, 270]"),
    ("three-steps", "steps = 3", 'steps_deg = [0, 240, 120]'),
    ("three-steps", "bright dark", "dark bright"),
    ("three-steps", "steps = 3", "steps = 3\ncode_inverted = true"),
    ("periods", "[49, 48, 42]", "[42, 48, 49]"),
    ("inverses", "gray-x ~gray-x", "~gray-x gray-x"),
    ("inverses", "[x]\n", '[x]\ncode_order = "fine-first"\n'),
    ("two-directions", "[0, 180, 90, 270]", "[0, 90, 180, 270]"),
    ("two-directions", 'left = "left/', 'left = "right/'),
)  # fmt: skip
"""Convention, correct words of its description, and a wrong replacement."""


def measure() -> Iterator[Measurement]:
    """Yield the figures of every convention, described and guessed, and of wrong descriptions."""
    with tempfile.TemporaryDirectory() as root:
        sets = {
            convention.name: make_set(convention, Path(root) / convention.name, WIDTH_PX) for convention in CONVENTIONS
        }
        for convention in CONVENTIONS:
            yield from _measured(convention, sets[convention.name])
            if convention.coarse:
                yield from _at_half_size(
                    convention, make_set(convention, Path(root) / f"{convention.name}-half", HALF_WIDTH_PX)
                )
        named = [_is_named(sets[name], before, after) for name, before, after in WRONG]
        yield Measurement(
            "wrong words that are named", float(sum(named)), f"of {len(named)}", at_least=float(len(named))
        )
        refused = sum(bool(read_foreign(convention.description, silent).wrong) for convention in sets.values())
        yield Measurement("right descriptions that are refused", float(refused), f"of {len(sets)}", at_most=0.0)


def _measured(convention: Convention, image_set: ForeignSet) -> Iterator[Measurement]:
    begin_s = process_time()
    judged = _judged(image_set, read_foreign(image_set.description, silent))
    cpu_s = process_time() - begin_s
    least_percent = LEAST_COARSE_PERCENT if convention.coarse else LEAST_PERCENT
    yield Measurement(
        f"{convention.name}: points of what all see", judged.complete_percent, "%", at_least=least_percent
    )
    yield Measurement(f"{convention.name}: distance from the surface", judged.off_mm, "mm")
    yield Measurement(
        f"{convention.name}: distance in pixels of disparity",
        judged.off_mm / judged.pixel_mm,
        "px",
        at_most=MOST_PIXELS,
    )
    yield Measurement(f"{convention.name}: noise that points say", judged.noise_mm, "mm")
    of_noise = judged.off_mm / (NORMAL_MEDIAN * judged.noise_mm)
    yield Measurement(f"{convention.name}: distance over that of such noise", of_noise, "", at_most=MOST_OF_NOISE)
    yield Measurement(
        f"{convention.name}: points farther away than {OUTLIER_MM:g} mm",
        judged.outliers_ppm,
        "ppm",
        at_most=MOST_OUTLIERS_PPM,
    )
    yield Measurement(f"{convention.name}: CPU, tests and points", cpu_s, "s")
    guess = image_set.description.with_name("guess.toml")
    best = guess_sequence(image_set.description.parent, silent)[0]
    guess.write_text(describe_guess(best, guess.parent), encoding="utf-8")
    guessed = _judged(image_set, read_foreign(guess, silent))
    yield Measurement(f"{convention.name}: points by a guess", guessed.complete_percent, "%", at_least=least_percent)


def _at_half_size(convention: Convention, image_set: ForeignSet) -> Iterator[Measurement]:
    """Measure with stripes finer than the simulator's pixels, which sample them at a point.

    So their edges lie a tenth of a pixel off instead of a hundredth; the points must state that.
    """
    judged = _judged(image_set, read_foreign(image_set.description, silent))
    name = f"{convention.name}, images {HALF_WIDTH_PX} px wide"
    yield Measurement(
        f"{name}: distance in pixels of disparity", judged.off_mm / judged.pixel_mm, "px", at_most=2.0 * MOST_PIXELS
    )
    of_noise = judged.off_mm / (NORMAL_MEDIAN * judged.noise_mm)
    yield Measurement(f"{name}: distance over that of such noise", of_noise, "", at_most=MOST_OF_STRIPES)


@dataclass(frozen=True)
class _Judged:
    """Quality of the points of a set."""

    complete_percent: float
    off_mm: float
    """Median distance from the true surface."""
    noise_mm: float
    """Median of the points' standard deviations."""
    outliers_ppm: float
    pixel_mm: float
    """Depth of a pixel of disparity: z² / (f b)."""


def _judged(image_set: ForeignSet, scan: ForeignScan) -> _Judged:
    points = find_points(scan.description, scan.rig, scan.cameras["left"], scan.cameras["right"])
    visible, has_point = image_set.renderer.view("left", 0.0).seen_by_all, points.cloud.mask
    points_mm = left_to_rig(image_set.renderer.truth, points.cloud.points_mm[has_point])
    distance_mm = np.abs(image_set.renderer.surface(0.0).distance_mm(points_mm))
    rig = scan.rig.rig
    baseline_mm = float(np.linalg.norm(rig.right.translation_mm))
    depth_mm = float(np.median(points.cloud.points_mm[has_point][:, 2]))
    return _Judged(
        100.0 * float((has_point & visible).sum()) / float(visible.sum()), float(np.median(distance_mm)),
        float(np.median(points.cloud.sigma_mm[has_point])), 1e6 * float(np.mean(distance_mm > OUTLIER_MM)),
        depth_mm**2 / (rig.left.lens.f_px[0] * baseline_mm),
    )  # fmt: skip


def _is_named(image_set: ForeignSet, before: str, after: str) -> bool:
    """Return True if a wrong word in place of a right one is reported."""
    changes = [(before, after)]
    if before.startswith("left = "):
        # Both names, or one camera's images would be there twice.
        changes = [('left = "left/', 'left = "xx/'), ('right = "right/', 'right = "left/'), ("xx/", "right/")]
    try:
        return bool(read_foreign(image_set.described(*changes), silent).wrong)
    except ForeignError:
        return False
