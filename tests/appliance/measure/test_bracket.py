"""Two exposures of one scene: merged where nothing moved, laid against each other after a hand's width, refused beyond."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.bracket import (
    LEAST_SHARED,
    MAX_MOVED_MM,
    MAX_RESIDUAL,
    MAX_TURNED_DEG,
    ProcessedSequence,
    _refusal,
)
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.news import Bracket
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.register import Registration
from appliance.measure.points.table import Cloud
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdict import Judgement, Verdict, faults_in, faults_of_both
from hw_sim.scene import Scene
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

SHORT, LONG = Exposure(3_000), Exposure(12_000)
WALL = Scene("plane", texture="slight")
UP_TO_PX = 0.3
"""What is at rest seems to move by less."""


@dataclass(frozen=True)
class Desk:
    """One wall, twice: the long exposure stands in the processor, the short one is held beside it."""

    processor: SequenceProcessor
    pipeline: Pipeline
    first: ProcessedSequence
    second: Cloud
    short_dn: NDArray[np.uint8]
    """(h, w): the short exposure's left bright frame."""

    def merged(self, first: ProcessedSequence) -> tuple[Bracket, Cloud | None]:
        made = self.processor.merge_with(first)
        return made, None if made.cloud is None else self.pipeline.table.cloud(made.cloud)


@pytest.fixture(scope="module")
def scans() -> tuple[RenderedScan, RenderedScan]:
    short, long = (render_scan(WALL, "nominal", 1, 200, 16, one.time_us / 1e6) for one in (SHORT, LONG))
    return short, long


@pytest.fixture
def desk(scans: tuple[RenderedScan, RenderedScan]) -> Iterator[Desk]:
    short, long = scans
    calibration = true_calibration(short.renderer.truth)
    with Pipeline(calibration, WATER, short.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        processor.process(short.frames, AcquisitionSettings(SHORT))
        first = processor.hold()
        second = pipeline.table.cloud(processor.process(long.frames, AcquisitionSettings(LONG)).cloud)
        yield Desk(processor, pipeline, first, second, short.frames["left"][short.sequence.bright])


def test_at_rest_the_pair_is_merged_pixel_by_pixel_and_is_better_than_either(desk: Desk) -> None:
    merged, cloud = desk.merged(desk.first)
    assert cloud is not None
    verdict = merged.pair.verdict
    assert (verdict.name, verdict.passed, verdict.text) == ("pair", True, "nothing moved: merged pixel by pixel")
    assert merged.pair.fault is None
    numbers = {name: number for name, number in verdict.numbers.items() if number is not None}
    assert (numbers["first_ms"], numbers["second_ms"]) == (3.0, 12.0)
    assert (numbers["first_gain_db"], numbers["second_gain_db"]) == (0.0, 0.0)
    assert numbers["first_points"] == len(desk.first.cloud.pixel)
    assert numbers["second_points"] == len(desk.second.pixel)
    assert numbers["points"] == len(cloud.pixel)
    assert numbers["moved_px"] < UP_TO_PX
    for side in ("left", "right"):
        shares = [numbers[f"{side}_{what}_percent"] for what in ("only_first", "only_second", "both")]
        assert 90.0 < sum(shares) <= 100.0, "the projector lights nearly all that either camera sees"
        assert shares[2] > 90.0
        assert numbers[f"{side}_masked_percent"] < 1.0
        assert numbers[f"{side}_shift_over_noise"] < 0.2
    alone = dict(zip(desk.second.pixel.tolist(), desk.second.sigma_mm.tolist(), strict=True))
    better = [s < alone[p] for p, s in zip(cloud.pixel.tolist(), cloud.sigma_mm.tolist(), strict=True) if p in alone]
    assert np.mean(better) > 0.95, "a merged point has the light of both"
    # Where the longer one is saturated, only the shorter one tells white from grey.
    np.testing.assert_array_equal(cloud.intensity, desk.short_dn.ravel()[cloud.pixel])


@pytest.mark.parametrize("which", ["first", "second"])
def test_a_sequence_in_which_something_moved_is_laid_against_the_other_one_in_space(desk: Desk, which: str) -> None:
    """Its maps are those of no moment, and must not be merged pixel by pixel."""
    first = replace(desk.first, moved=which == "first")
    desk.processor._moved = desk.processor._compensated = which == "second"
    merged, cloud = desk.merged(first)
    assert cloud is not None
    verdict = merged.pair.verdict
    assert verdict.passed
    assert verdict.text.endswith("points were registered")
    numbers = {name: number or 0.0 for name, number in verdict.numbers.items()}
    assert numbers["points"] == len(cloud.pixel)
    assert numbers["points_both_percent"] == pytest.approx(100.0, abs=5.0)
    assert numbers["points_only_second_percent"] == pytest.approx(0.0, abs=5.0)
    assert numbers["points_masked_percent"] == pytest.approx(0.0, abs=1.0)
    assert numbers["shared_percent"] == pytest.approx(100.0, abs=2.0)
    assert 0.2 < numbers["residual_over_noise"] < 1.2, "both are one wall"
    assert numbers["moved_mm"] == pytest.approx(0.0, abs=0.3)
    grey = cloud.intensity / np.maximum(desk.short_dn.ravel()[cloud.pixel].astype(float), 1.0)
    assert np.median(grey) == pytest.approx(1.0, abs=0.03), "both clouds' grey values are those of the shorter exposure"


def test_points_that_motion_spoilt_or_that_are_hardly_any_are_not_mixed_with_others(desk: Desk) -> None:
    few = desk.first.cloud.thinned(20)
    none = replace(few, pixel=np.zeros(0, np.uint32), points_mm=np.zeros((0, 3), np.float32))
    for cloud in (few, none):
        merged, _ = desk.merged(replace(desk.first, cloud=cloud))
        assert merged.cloud is None
        assert "too little overlap" in merged.pair.verdict.text
    for which, first in (("first", replace(desk.first, moved=True, spoilt=True)), ("second", desk.first)):
        desk.processor._moved = which == "second"
        merged, _ = desk.merged(first)
        assert (merged.cloud, merged.pair.verdict.passed) == (None, False)
        fault = merged.pair.fault
        assert fault is not None
        assert fault.code is FaultCode.MOVED
        assert fault.detail == f"instrument or object moved during the {which} exposure"
        assert fault.numbers["second_ms"] == 12.0


MOVED_MM = "moved by {:.2f} mm (5.0 px, {:.2f} deg) between the exposures; up to 10 mm and 3 deg"
NOT_RIGID = "do not show one rigid object: {} % of their points lie on one surface, {} times"


@pytest.mark.parametrize(
    ("moved_mm", "turned_deg", "residual", "shared", "why"),
    [
        (9.9, 2.9, 1.5, 0.61, None),
        (MAX_MOVED_MM, MAX_TURNED_DEG, MAX_RESIDUAL, LEAST_SHARED, None),
        (10.1, 0.0, 1.0, 1.0, MOVED_MM.format(10.1, 0.0)),
        (0.0, 3.1, 1.0, 1.0, MOVED_MM.format(0.0, 3.1)),
        (0.0, 0.0, 1.7, 1.0, NOT_RIGID.format(100, 1.7)),
        (0.0, 0.0, 1.0, 0.59, NOT_RIGID.format(59, 1.0)),
    ],
)
def test_a_pair_is_taken_up_to_a_centimetre_and_three_degrees_and_if_it_is_one_rigid_thing(
    moved_mm: float, turned_deg: float, residual: float, shared: float, why: str | None
) -> None:
    said = _refusal(Registration(np.eye(3), np.zeros(3), moved_mm, 5.0, turned_deg, residual, 0.1, shared))
    assert (said is None) == (why is None)
    assert (why or "") in (said or "")


def judged(code: FaultCode | None, detail: str = "") -> Judgement:
    return Judgement(Verdict("any", code is None), None if code is None else Fault(code, detail))


def test_a_pairs_faults_are_those_of_both_without_what_the_other_one_makes_up_for() -> None:
    first = [judged(FaultCode.TOO_BRIGHT), judged(None), judged(FaultCode.WATER_DIRTY, "in the first")]
    second = [judged(FaultCode.TOO_DARK), judged(FaultCode.WATER_DIRTY, "in the second"), judged(FaultCode.WINDOW)]
    found = faults_of_both(faults_in((*first, *second, judged(FaultCode.MOVED))))
    assert [fault.code for fault in found] == [FaultCode.WATER_DIRTY, FaultCode.WINDOW, FaultCode.MOVED]
    assert found[0].detail == "in the first", "told once, as it was found first"
    assert faults_of_both(faults_in((judged(None), judged(FaultCode.TOO_DARK), judged(None)))) == ()
