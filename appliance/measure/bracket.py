"""The merging of a bracket: two sequences of one scene become one cloud, or are refused.

At rest, the decoded maps are merged, pixel by pixel, before points are computed. After a small motion each sequence
gets points of its own, and the second cloud is registered to the first. Otherwise the bracket is refused: the first
sequence is a scan by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudLocation
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
"""Largest motion between the sequences; registration works up to here for any object (docs/exposure.md)."""
MAX_TURNED_DEG = 3.0
MAX_RESIDUAL = 1.6
"""Largest distance of the two surfaces over its standard deviation for one rigid object."""
LEAST_SHARED = 0.6
"""Least share of the common points that lie on one surface."""
STILL_PX = 0.3
"""Largest motion at which the maps are merged: on small objects noise looks like so much motion."""


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedSequence:
    """One of the two sequences after its full cloud."""

    cloud: Cloud
    maps: Mapping[str, DecodedMaps]
    """Decoded maps by side; specks are masked."""
    bright: NDArray[np.uint8]
    """(h, w) uint8: the left bright frame."""
    exposure: Exposure
    noise: StereoNoise
    moved: bool
    """True if there was motion during the capture: the maps belong to no single moment; the points may."""
    spoilt: bool
    """True if the motion could not be compensated in the points."""


@dataclass(slots=True)
class _Numbers:
    numbers: dict[str, float | None] = field(default_factory=dict)

    def refused(self, reason: str) -> Bracket:
        verdict = Verdict("pair", False, self.numbers, reason)
        return Bracket(None, Judgement(verdict, Fault(FaultCode.MOVED, reason, _without_none(self.numbers))))

    def merged(self, cloud: CloudLocation, method: str) -> Bracket:
        self.numbers["points"] = float(cloud.summary.points)
        return Bracket(cloud, Judgement(Verdict("pair", True, self.numbers, method)))


def merge_bracket(pipeline: Pipeline, first: ProcessedSequence, second: ProcessedSequence) -> Bracket:
    """Return the cloud of both sequences in the frame of the first, and their judgement.

    Call it after ``pipeline`` has computed the second one's full cloud; its maps are changed. The same two sequences
    give the same points, bit by bit.
    """
    evidence = _Numbers()
    for name, sequence in (("first", first), ("second", second)):
        evidence.numbers[f"{name}_ms"], evidence.numbers[f"{name}_gain_db"] = (
            sequence.exposure.time_us / 1e3,
            sequence.exposure.gain_db,
        )
        evidence.numbers[f"{name}_points"] = float(len(sequence.cloud.pixel))
    # Compensated points can be registered; points of no single moment cannot.
    if first.spoilt or second.spoilt:
        which = "first" if first.spoilt else "second"
        return evidence.refused(f"instrument or object moved during the {which} exposure")
    height_px, width_px = first.bright.shape
    surface = surface_of(first.cloud, second.cloud, (height_px, width_px)) if len(first.cloud.pixel) else None
    registration = None if surface is None else register_exposures(surface, second.cloud)
    if surface is None or registration is None:
        return evidence.refused("the two exposures have too little overlap for a registration")
    evidence.numbers |= _registration(registration)
    # Pixel by pixel without motion, which loses no points; otherwise in space, which needs points of one moment.
    if registration.moved_px < STILL_PX and not first.moved and not second.moved:
        agreements, variance_px2 = _merge_maps(pipeline, first, second)
        evidence.numbers |= _agreements(agreements)
        if all(agreement.agrees for agreement in agreements.values()):
            # The image of the shorter exposure is saturated in fewer pixels.
            shorter = min(first, second, key=lambda sequence: sequence.exposure.light)
            merged = pipeline.find_changed(shorter.bright, variance_px2)
            return evidence.merged(merged, "nothing moved: merged pixel by pixel")
    if (reason := _refusal(registration)) is not None:
        return evidence.refused(reason)
    # The intensities of both are scaled to the darker exposure.
    light = min(first.exposure.light, second.exposure.light)
    fused = fuse(
        surface, first.cloud, second.cloud, registration, (light / first.exposure.light, light / second.exposure.light)
    )
    evidence.numbers["points_only_second_percent"] = 100.0 * fused.second
    evidence.numbers["points_both_percent"] = 100.0 * fused.both
    evidence.numbers["points_masked_percent"] = 100.0 * fused.masked
    return evidence.merged(
        pipeline.table.put(fused.cloud), f"moved by {_amount(registration)} in between: points were registered"
    )


def _merge_maps(
    pipeline: Pipeline, first: ProcessedSequence, second: ProcessedSequence
) -> tuple[dict[str, Agreement], dict[str, NDArray[np.float32]]]:
    """Merge both sequences' maps into the pipeline's, which are the second one's.

    Returns the agreements, and the variance of the merged coordinates in px², by side.
    """
    agreements, variance_px2 = {}, {}
    for side in SIDES:
        maps, noise = pipeline.decoded(side), (of_side(second.noise, side), of_side(first.noise, side))
        variance_px2[side] = np.empty(maps.p_px.shape, np.float32)
        agreements[side] = merge(maps, first.maps[side], noise, pipeline.sequence.period_px, variance_px2[side])
    return agreements, variance_px2


def _refusal(registration: Registration) -> str | None:
    # The motion first: beyond its limit, residual and share have no meaning.
    if registration.moved_mm > MAX_MOVED_MM or registration.turned_deg > MAX_TURNED_DEG:
        return (
            f"moved by {_amount(registration)} between the exposures; up to {MAX_MOVED_MM:g} mm and "
            f"{MAX_TURNED_DEG:g} deg are compensated"
        )
    if registration.residual > MAX_RESIDUAL or registration.shared < LEAST_SHARED:
        return (
            f"the two exposures do not show one rigid object: {100.0 * registration.shared:.0f} % of their points lie "
            f"on one surface, {registration.residual:.1f} times the noise apart"
        )
    return None


def _amount(registration: Registration) -> str:
    return f"{registration.moved_mm:.2f} mm ({registration.moved_px:.1f} px, {registration.turned_deg:.2f} deg)"


def _registration(registration: Registration) -> dict[str, float | None]:
    return {
        "moved_mm": registration.moved_mm,
        "moved_px": registration.moved_px,
        "turned_deg": registration.turned_deg,
        "residual_over_noise": registration.residual,
        "residual_mm": registration.residual_mm,
        "shared_percent": 100.0 * registration.shared,
    }


def _agreements(agreements: Mapping[str, Agreement]) -> dict[str, float | None]:
    """Return the agreements as numbers of the verdict."""
    numbers: dict[str, float | None] = {}
    for side, a in agreements.items():
        numbers[f"{side}_only_first_percent"] = 100.0 * a.second
        numbers[f"{side}_only_second_percent"] = 100.0 * a.first
        numbers[f"{side}_both_percent"] = 100.0 * a.both
        numbers[f"{side}_masked_percent"] = 100.0 * a.masked
        numbers[f"{side}_shift_over_noise"] = a.shift
    return numbers


def _without_none(numbers: Mapping[str, float | None]) -> dict[str, float]:
    return {name: number for name, number in numbers.items() if number is not None}
