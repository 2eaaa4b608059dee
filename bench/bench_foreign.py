"""Image sets of six foreign conventions by the simulator: how complete and how accurate their points are, and which wrong words are named."""

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
from bench.result import Measured
from tests.support.foreign_sets import CONVENTIONS, Convention, ForeignSet, make_set
from tests.support.truth import left_to_rig

WIDTH_PX, HALF_WIDTH_PX = 800, 400
OUTLIER_MM = 1.0
LEAST_PERCENT, LEAST_COARSE_PERCENT = 97.0, 95.0
"""Share of the pixels that all eyes see: at 800 px, a ring of one to two pixels about each edge is 1 % to 3 % of them. Of stripes alone the
ends of each surface, half a stripe, are drawn from one side only, and their points rejected."""
MOST_PIXELS = 0.1
"""Median distance from the surface, in pixels of disparity: a tenth is what a rig as good as this one's calibration is worth."""
NORMAL_MEDIAN = 0.6745
MOST_OF_NOISE = 2.0
"""Median distance over that of normal noise of the size that the points say; phases of three steps have ripple of the projector besides."""
MOST_OF_STRIPES = 1.3
"""The same of stripes alone, whose points say the error of their borders."""
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
"""Convention, what its description says, and a wrong word in its place."""


def measure() -> Iterator[Measured]:
    """Every convention as described and as guessed, and every wrong word."""
    with tempfile.TemporaryDirectory() as root:
        made = {one.name: make_set(one, Path(root) / one.name, WIDTH_PX) for one in CONVENTIONS}
        for one in CONVENTIONS:
            yield from _measured(one, made[one.name])
            if one.coarse:
                yield from _at_half_size(one, make_set(one, Path(root) / f"{one.name}-half", HALF_WIDTH_PX))
        named = [_is_named(made[name], before, after) for name, before, after in WRONG]
        yield Measured("wrong words that are named", float(sum(named)), f"of {len(named)}", at_least=float(len(named)))
        refused = sum(bool(read_foreign(one.description, silent).wrong) for one in made.values())
        yield Measured("right descriptions that are refused", float(refused), f"of {len(made)}", at_most=0.0)


def _measured(one: Convention, made: ForeignSet) -> Iterator[Measured]:
    begin_s = process_time()
    found = _judged(made, read_foreign(made.description, silent))
    cpu_s = process_time() - begin_s
    least_percent = LEAST_COARSE_PERCENT if one.coarse else LEAST_PERCENT
    yield Measured(f"{one.name}: points of what all see", found.complete_percent, "%", at_least=least_percent)
    yield Measured(f"{one.name}: distance from the surface", found.off_mm, "mm")
    yield Measured(
        f"{one.name}: distance in pixels of disparity", found.off_mm / found.pixel_mm, "px", at_most=MOST_PIXELS
    )
    yield Measured(f"{one.name}: noise that points say", found.noise_mm, "mm")
    of_noise = found.off_mm / (NORMAL_MEDIAN * found.noise_mm)
    yield Measured(f"{one.name}: distance over that of such noise", of_noise, "", at_most=MOST_OF_NOISE)
    yield Measured(
        f"{one.name}: points farther away than {OUTLIER_MM:g} mm", found.outliers_ppm, "ppm", at_most=MOST_OUTLIERS_PPM
    )
    yield Measured(f"{one.name}: CPU, tests and points", cpu_s, "s")
    guess = made.description.with_name("guess.toml")
    best = guess_sequence(made.description.parent, silent)[0]
    guess.write_text(describe_guess(best, guess.parent), encoding="utf-8")
    guessed = _judged(made, read_foreign(guess, silent))
    yield Measured(f"{one.name}: points by a guess", guessed.complete_percent, "%", at_least=least_percent)


def _at_half_size(one: Convention, made: ForeignSet) -> Iterator[Measured]:
    """Stripes that the simulator's pixels sample at a point: it does not take the mean of a pattern that is finer than they are, so that
    borders lie a tenth of a pixel off instead of a hundredth. The points must say so."""
    found = _judged(made, read_foreign(made.description, silent))
    name = f"{one.name}, images {HALF_WIDTH_PX} px wide"
    yield Measured(
        f"{name}: distance in pixels of disparity", found.off_mm / found.pixel_mm, "px", at_most=2.0 * MOST_PIXELS
    )
    of_noise = found.off_mm / (NORMAL_MEDIAN * found.noise_mm)
    yield Measured(f"{name}: distance over that of such noise", of_noise, "", at_most=MOST_OF_STRIPES)


@dataclass(frozen=True)
class _Judged:
    """How good a set's points are."""

    complete_percent: float
    off_mm: float
    """Median distance from the true surface."""
    noise_mm: float
    """Median of the standard deviations that the points say."""
    outliers_ppm: float
    pixel_mm: float
    """What a pixel of disparity is worth in depth: z² / (f b)."""


def _judged(made: ForeignSet, scan: ForeignScan) -> _Judged:
    found = find_points(scan.description, scan.rig, scan.cameras["left"], scan.cameras["right"])
    seen, there = made.renderer.view("left", 0.0).seen_by_all, found.cloud.mask
    points_mm = left_to_rig(made.renderer.truth, found.cloud.points_mm[there])
    distance_mm = np.abs(made.renderer.surface(0.0).distance_mm(points_mm))
    rig = scan.rig.rig
    baseline_mm = float(np.linalg.norm(rig.right.translation_mm))
    depth_mm = float(np.median(found.cloud.points_mm[there][:, 2]))
    return _Judged(
        100.0 * float((there & seen).sum()) / float(seen.sum()), float(np.median(distance_mm)),
        float(np.median(found.cloud.sigma_mm[there])), 1e6 * float(np.mean(distance_mm > OUTLIER_MM)),
        depth_mm**2 / (rig.left.lens.f_px[0] * baseline_mm),
    )  # fmt: skip


def _is_named(made: ForeignSet, before: str, after: str) -> bool:
    """Tell whether a wrong word in place of a right one is called wrong."""
    changes = [(before, after)]
    if before.startswith("left = "):
        # Both names, or one camera's images would be there twice.
        changes = [('left = "left/', 'left = "xx/'), ('right = "right/', 'right = "left/'), ("xx/", "right/")]
    try:
        return bool(read_foreign(made.described(*changes), silent).wrong)
    except ForeignError:
        return False
