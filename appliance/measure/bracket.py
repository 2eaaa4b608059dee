"""Owns two sequences of one scene as one scan: whether they show the same, how far it moved in between, and one cloud.

At rest, the decoded maps are merged, pixel by pixel, before points are found. After a small movement each sequence gets
its own points, and the second cloud is laid against the first. Anything else is refused: the first sequence is a scan
by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import Found
from appliance.measure.decode.decoder import DecodedMaps
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import StereoNoise
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.news import Bracket
from appliance.measure.points.fuse import fuse
from appliance.measure.points.merge import Agreement, merge
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.register import Registration, register_exposures
from appliance.measure.points.surface import surface_of
from appliance.measure.points.table import Cloud
from appliance.measure.verdict import Judgement, Verdict

MAX_MOVED_MM = 10.0
"""Greatest movement from one sequence to the other; it is found up to here whatever the object (docs/exposure.md)."""
MAX_TURNED_DEG = 3.0
MAX_RESIDUAL = 1.6
"""Distance of the two surfaces over what is expected: beyond, they are not one rigid thing."""
LEAST_SHARED = 0.6
"""Share of the points both have that must lie on one surface."""
STILL_PX = 0.3
"""Movement up to which the maps are compared all the same: noise may look like so much movement on small objects."""


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedSequence:
    """One of the two sequences after its full cloud."""

    cloud: Cloud
    maps: Mapping[str, DecodedMaps]
    """Decoded maps by side; what passed by is masked."""
    bright: NDArray[np.uint8]
    """(h, w) uint8: the left bright frame."""
    exposure: Exposure
    noise: StereoNoise
    moved: bool
    """True if something moved while it was recorded: its maps are those of no moment; its points may be."""
    spoilt: bool
    """True if the points are spoilt, too: the motion could not be taken out of them."""


@dataclass(slots=True)
class _Story:
    numbers: dict[str, float | None] = field(default_factory=dict)

    def refused(self, why: str) -> Bracket:
        verdict = Verdict("pair", False, self.numbers, why)
        return Bracket(None, Judgement(verdict, Fault(FaultCode.MOVED, why, _known(self.numbers))))

    def merged(self, found: Found, how: str) -> Bracket:
        self.numbers["points"] = float(found.summary.points)
        return Bracket(found, Judgement(Verdict("pair", True, self.numbers, how)))


def merge_bracket(pipeline: Pipeline, first: ProcessedSequence, second: ProcessedSequence) -> Bracket:
    """Return the cloud of both in the frame of the first, and their judgement; after ``pipeline`` found the second
    one's full cloud.

    The pipeline's maps are changed. The same two sequences give the same points, bit by bit.
    """
    story = _Story()
    for name, one in (("first", first), ("second", second)):
        story.numbers[f"{name}_ms"], story.numbers[f"{name}_gain_db"] = one.exposure.time_us / 1e3, one.exposure.gain_db
        story.numbers[f"{name}_points"] = float(len(one.cloud.pixel))
    # Compensated points can be registered, points of no moment cannot.
    if first.spoilt or second.spoilt:
        which = "first" if first.spoilt else "second"
        return story.refused(f"instrument and scene moved while the {which} exposure was recorded")
    height_px, width_px = first.bright.shape
    surface = surface_of(first.cloud, second.cloud, (height_px, width_px)) if len(first.cloud.pixel) else None
    found = None if surface is None else register_exposures(surface, second.cloud)
    if surface is None or found is None:
        return story.refused("the two exposures have too little in common to tell how they lie to each other")
    story.numbers |= _registration(found)
    # Pixel by pixel where nothing moved, which loses nothing; else in space, where points of both must be rays of one
    # moment.
    if found.moved_px < STILL_PX and not first.moved and not second.moved:
        agreements, variance_px2 = _merge_maps(pipeline, first, second)
        story.numbers |= _agreements(agreements)
        if all(agreement.agrees for agreement in agreements.values()):
            # The picture of the shorter exposure is not saturated where the longer one is.
            shorter = min(first, second, key=lambda one: one.exposure.light)
            merged = pipeline.find_changed(shorter.bright, variance_px2)
            return story.merged(merged, "nothing moved: merged pixel by pixel")
    if (why := _refusal(found)) is not None:
        return story.refused(why)
    # Intensities of both in the light of the darker exposure, so that they mean the same in the fused cloud.
    light = min(first.exposure.light, second.exposure.light)
    both = fuse(
        surface, first.cloud, second.cloud, found, (light / first.exposure.light, light / second.exposure.light)
    )
    story.numbers["points_only_second_percent"] = 100.0 * both.second
    story.numbers["points_both_percent"] = 100.0 * both.both
    story.numbers["points_masked_percent"] = 100.0 * both.masked
    return story.merged(pipeline.table.put(both.cloud), f"moved by {_amount(found)} in between: points were registered")


def _merge_maps(
    pipeline: Pipeline, first: ProcessedSequence, second: ProcessedSequence
) -> tuple[dict[str, Agreement], dict[str, NDArray[np.float32]]]:
    """Merge both sequences' maps into the pipeline's, which are the second one's; return how they agree, and the
    variance of the merged coordinates in px², by side."""
    agreements, variance_px2 = {}, {}
    for side in SIDES:
        maps, noise = pipeline.decoded(side), (of_side(second.noise, side), of_side(first.noise, side))
        variance_px2[side] = np.empty(maps.p_px.shape, np.float32)
        agreements[side] = merge(maps, first.maps[side], noise, pipeline.sequence.period_px, variance_px2[side])
    return agreements, variance_px2


def _refusal(found: Registration) -> str | None:
    # In this order: beyond what can be found, residual and share say nothing.
    if found.moved_mm > MAX_MOVED_MM or found.turned_deg > MAX_TURNED_DEG:
        return f"moved by {_amount(found)} between the exposures; up to {MAX_MOVED_MM:g} mm and {MAX_TURNED_DEG:g} deg are undone"
    if found.residual > MAX_RESIDUAL or found.shared < LEAST_SHARED:
        return (
            f"the two exposures do not show one rigid thing: {100.0 * found.shared:.0f} % of their points lie on one "
            f"surface, {found.residual:.1f} times the noise apart"
        )
    return None


def _amount(found: Registration) -> str:
    return f"{found.moved_mm:.2f} mm ({found.moved_px:.1f} px, {found.turned_deg:.2f} deg)"


def _registration(found: Registration) -> dict[str, float | None]:
    return {
        "moved_mm": found.moved_mm,
        "moved_px": found.moved_px,
        "turned_deg": found.turned_deg,
        "residual_over_noise": found.residual,
        "residual_mm": found.residual_mm,
        "shared_percent": 100.0 * found.shared,
    }


def _agreements(found: Mapping[str, Agreement]) -> dict[str, float | None]:
    """Return the agreements as numbers of the verdict; the maps were merged into the second sequence's."""
    numbers: dict[str, float | None] = {}
    for side, a in found.items():
        numbers[f"{side}_only_first_percent"] = 100.0 * a.second
        numbers[f"{side}_only_second_percent"] = 100.0 * a.first
        numbers[f"{side}_both_percent"] = 100.0 * a.both
        numbers[f"{side}_masked_percent"] = 100.0 * a.masked
        numbers[f"{side}_shift_over_noise"] = a.shift
    return numbers


def _known(numbers: Mapping[str, float | None]) -> dict[str, float]:
    return {name: number for name, number in numbers.items() if number is not None}
