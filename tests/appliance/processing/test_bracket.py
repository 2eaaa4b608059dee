"""Two exposures of one scene: merged where nothing moved, laid against each other after a hand's width, refused beyond."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.processing.bracket import (
    LEAST_SHARED,
    MAX_MOVED_MM,
    MAX_RESIDUAL,
    MAX_TURNED_DEG,
    Merged,
    ProcessedSequence,
    _refusal,
    faults_of,
)
from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.decode.decoder import Mask
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.register import Registration
from appliance.reconstruct.table import Cloud
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.noise import TYPICAL, StereoNoise
from appliance.scan.verdict import Judgement, Verdict
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
    bright: dict[str, NDArray[np.float64]]
    """(h, w) of the left bright frame, by exposure."""

    def merged(self, first: ProcessedSequence) -> tuple[Merged, Cloud | None]:
        made = self.processor.merge_with(first)
        return made, None if made.found is None else self.pipeline.table.cloud(made.found)


def rendered(exposure: Exposure, scene: Scene = WALL) -> RenderedScan:
    return render_scan(scene, "nominal", 1, 256, 16, exposure.time_us / 1e6)


@pytest.fixture(scope="module")
def scans() -> tuple[RenderedScan, RenderedScan]:
    return rendered(SHORT), rendered(LONG)


@pytest.fixture
def desk(scans: tuple[RenderedScan, RenderedScan]) -> Iterator[Desk]:
    short, long = scans
    calibration = true_calibration(short.renderer.truth)
    with Pipeline(calibration, WATER, short.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        processor.process(short.frames, AcquisitionSettings(SHORT))
        first = processor.hold()
        second = pipeline.table.cloud(processor.process(long.frames, AcquisitionSettings(LONG)).found)
        bright = {
            name: scan.frames["left"][scan.sequence.bright].astype(np.float64)
            for name, scan in (("short", short), ("long", long))
        }
        yield Desk(processor, pipeline, first, second, bright)


def test_at_rest_the_pair_is_merged_pixel_by_pixel_and_is_better_than_either(desk: Desk) -> None:
    merged, cloud = desk.merged(desk.first)
    assert cloud is not None
    verdict = merged.judgement.verdict
    assert (verdict.name, verdict.passed, verdict.text) == ("pair", True, "nothing moved: merged pixel by pixel")
    assert merged.judgement.fault is None
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


def test_a_merged_point_is_as_grey_as_the_shorter_exposure_saw_it(desk: Desk) -> None:
    """Where the longer one is saturated, only the shorter one tells white from grey."""
    _, cloud = desk.merged(desk.first)
    assert cloud is not None
    np.testing.assert_array_equal(cloud.intensity, desk.bright["short"].ravel()[cloud.pixel])


def test_also_where_the_shorter_exposure_is_the_second_one(desk: Desk) -> None:
    """Else the preview of a pair would be saturated wherever its first picture is."""
    _, cloud = desk.merged(replace(desk.first, exposure=Exposure(4 * LONG.time_us)))
    assert cloud is not None
    np.testing.assert_array_equal(cloud.intensity, desk.bright["long"].ravel()[cloud.pixel])


def test_of_two_exposures_the_less_noisy_one_counts_for_more(desk: Desk) -> None:
    """The first one is taken for so noisy that nearly nothing of it is believed where the second one has a coordinate, too."""
    noisy = replace(TYPICAL, read_dn=20.0 * TYPICAL.read_dn, dn_per_e=400.0 * TYPICAL.dn_per_e)
    second = desk.pipeline.decoded("left").copied()
    desk.merged(replace(desk.first, noise=StereoNoise(noisy, noisy)))
    both = desk.pipeline.decoded("left").p_px
    apart = [np.nanmedian(np.abs(both - maps.p_px)) for maps in (desk.first.maps["left"], second)]
    assert apart[1] < 0.1 * apart[0]


def test_what_only_one_exposure_shows_is_counted_for_that_one(desk: Desk) -> None:
    """The first exposure loses a strip of the left image, the second one a wider strip beside it."""
    for maps, columns in ((desk.first.maps["left"], slice(60, 80)), (desk.pipeline.decoded("left"), slice(120, 160))):
        lost = np.zeros(maps.p_px.shape, bool)
        lost[:, columns] = True
        maps.p_px[lost] = maps.q_px[lost] = np.nan
        maps.mask[lost] = Mask.SATURATED
    numbers = desk.merged(desk.first)[0].judgement.verdict.numbers
    only_first, only_second = numbers["left_only_first_percent"], numbers["left_only_second_percent"]
    assert only_first is not None
    assert only_second is not None
    assert only_first == pytest.approx(2.0 * only_second, rel=0.25)
    assert numbers["right_only_first_percent"] == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("which", ["first", "second"])
def test_a_sequence_in_which_something_moved_is_laid_against_the_other_one_in_space(desk: Desk, which: str) -> None:
    """Its maps are those of no moment, and must not be merged pixel by pixel."""
    if which == "first":
        first = replace(desk.first, moved=True)
    else:
        first, desk.processor._moved, desk.processor._compensated = desk.first, True, True
    merged, cloud = desk.merged(first)
    assert cloud is not None
    verdict = merged.judgement.verdict
    assert verdict.passed
    assert verdict.text.endswith("points were registered")
    numbers = verdict.numbers
    assert numbers["points"] == len(cloud.pixel)
    assert numbers["points_both_percent"] == pytest.approx(100.0, abs=5.0)
    assert numbers["points_only_second_percent"] == pytest.approx(0.0, abs=5.0)
    assert numbers["points_masked_percent"] == pytest.approx(0.0, abs=1.0)
    assert numbers["shared_percent"] == pytest.approx(100.0, abs=2.0)
    assert numbers["residual_over_noise"] is not None
    assert 0.2 < numbers["residual_over_noise"] < 1.2, "both are one wall"
    assert numbers["moved_mm"] == pytest.approx(0.0, abs=0.3)
    grey = cloud.intensity / np.maximum(desk.bright["short"].ravel()[cloud.pixel], 1.0)
    assert np.median(grey) == pytest.approx(1.0, abs=0.03), "both clouds' grey values are those of the shorter exposure"


def test_maps_are_not_merged_where_one_camera_sees_that_something_moved(desk: Desk) -> None:
    """Movement may show in one camera alone: along the rays of the other."""
    desk.first.maps["right"].p_px += np.float32(0.5)
    merged, cloud = desk.merged(desk.first)
    assert cloud is not None
    assert merged.judgement.verdict.text.endswith("points were registered")
    right, left = (merged.judgement.verdict.numbers[f"{side}_shift_over_noise"] for side in ("right", "left"))
    assert right is not None
    assert left is not None
    assert right > 1.0 > left


@pytest.mark.parametrize("which", ["first", "second"])
def test_points_that_motion_spoilt_are_not_mixed_with_others(desk: Desk, which: str) -> None:
    if which == "first":
        first = replace(desk.first, moved=True, spoilt=True)
    else:
        first, desk.processor._moved = desk.first, True
    merged, cloud = desk.merged(first)
    assert cloud is None
    fault = merged.judgement.fault
    assert fault is not None
    assert fault.code is FaultCode.MOVED
    assert fault.detail == f"instrument and scene moved while the {which} exposure was recorded"
    assert fault.numbers["second_ms"] == 12.0
    assert merged.judgement.verdict.passed is False


def test_a_first_exposure_without_points_has_nothing_to_lay_the_second_one_against(desk: Desk) -> None:
    none = replace(
        desk.first.cloud.thinned(10**9), pixel=np.zeros(0, np.uint32), points_mm=np.zeros((0, 3), np.float32)
    )
    merged, _ = desk.merged(replace(desk.first, cloud=none))
    assert merged.found is None
    assert merged.judgement.verdict.text == (
        "the two exposures have too little in common to tell how they lie to each other"
    )


def test_a_first_exposure_with_a_handful_of_points_is_not_enough_either(desk: Desk) -> None:
    merged, _ = desk.merged(replace(desk.first, cloud=desk.first.cloud.thinned(20)))
    assert merged.found is None
    assert "too little in common" in merged.judgement.verdict.text


def lies(moved_mm: float, turned_deg: float, residual: float, shared: float) -> Registration:
    return Registration(np.eye(3), np.zeros(3), moved_mm, 5.0, turned_deg, residual, 0.1, shared)


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (lies(9.9, 2.9, 1.5, 0.61), None),
        (lies(MAX_MOVED_MM, MAX_TURNED_DEG, MAX_RESIDUAL, LEAST_SHARED), None),
        (
            lies(10.1, 0.0, 1.0, 1.0),
            "moved by 10.10 mm (5.0 px, 0.00 deg) between the exposures; up to 10 mm and 3 deg",
        ),
        (lies(0.0, 3.1, 1.0, 1.0), "moved by 0.00 mm (5.0 px, 3.10 deg) between the exposures; up to 10 mm and 3 deg"),
        (lies(0.0, 0.0, 1.7, 1.0), "do not show one rigid thing: 100 % of their points lie on one surface, 1.7 times"),
        (lies(0.0, 0.0, 1.0, 0.59), "do not show one rigid thing: 59 % of their points lie on one surface, 1.0 times"),
    ],
)
def test_a_pair_is_taken_up_to_a_centimetre_and_three_degrees_and_if_it_is_one_rigid_thing(
    found: Registration, why: str | None
) -> None:
    said = _refusal(found)
    assert (said is None) == (why is None)
    assert (why or "") in (said or "")


def judged(code: FaultCode | None, detail: str = "") -> Judgement:
    return Judgement(Verdict("any", code is None), None if code is None else Fault(code, detail))


def test_a_pairs_faults_are_those_of_both_without_what_the_other_one_makes_up_for() -> None:
    first = [judged(FaultCode.TOO_BRIGHT), judged(None), judged(FaultCode.WATER_DIRTY, "in the first")]
    second = [judged(FaultCode.TOO_DARK), judged(FaultCode.WATER_DIRTY, "in the second"), judged(FaultCode.WINDOW)]
    found = faults_of(first, second, judged(FaultCode.MOVED))
    assert [fault.code for fault in found] == [FaultCode.WATER_DIRTY, FaultCode.WINDOW, FaultCode.MOVED]
    assert found[0].detail == "in the first", "told once, as it was found first"
    assert faults_of([judged(None)], [judged(FaultCode.TOO_DARK)], judged(None)) == ()
