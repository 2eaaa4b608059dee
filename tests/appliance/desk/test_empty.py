"""Why a reconstruction has no points is told in the order of blame: nothing seen, a calibration that does not fit, points that were masked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from appliance.measure.calibration.design import Design, design_calibration
from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.decode.decoder import Mask
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.verdict import Judgement, Verdict
from appliance.store.reprocess import EmptyCloud, why_empty

WATER = Water(20.0, 0.0, 530.0)
WIDTH_PX, HEIGHT_PX = 160, 120
CALIBRATION = design_calibration(
    Design(11.5, 4.5 * 10, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", WIDTH_PX, HEIGHT_PX, WATER
)
MURKY = Judgement(Verdict("water", False), Fault(FaultCode.TOO_DARK, "of 2 % of the picture"))


@pytest.fixture(scope="module")
def pipeline() -> Iterator[Pipeline]:
    with Pipeline(CALIBRATION, WATER, build_sequence(16)) as made:
        yield made


def see_wall(pipeline: Pipeline, raised_px: float = 0.0) -> None:
    """Push what both cameras see of a wall at 520 mm with the pattern on it, 4 px to the mm; the right one sees all patterns
    ``raised_px`` lower."""
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    uv = np.stack([u, v], -1).reshape(-1, 2).astype(np.float64)
    sequence = pipeline.sequence
    pipeline.reset()
    for side, camera in (("left", CALIBRATION.rig.left), ("right", CALIBRATION.rig.right)):
        origin, direction = camera.rays(uv, WATER.index)
        place = origin + direction * ((520.0 - origin[:, 2:]) / direction[:, 2:])
        p, q = 4.0 * (place[:, 0] - 115.0) + 511.5, 4.0 * place[:, 1] + 383.5
        q = q + raised_px * (side == "right")
        lit = (p > 0.0) & (p < 1023.0) & (q > 0.0) & (q < 767.0)
        frames = np.empty((len(sequence), HEIGHT_PX, WIDTH_PX), np.uint8)
        for k, pattern in enumerate(sequence.patterns):
            at = p if pattern.direction is Direction.X else q
            codes = pattern.codes().astype(np.float64)
            light = np.interp(at, np.arange(codes.size), codes)
            frames[k] = np.rint(np.where(lit, 5.0 + 0.8 * light, 5.0)).reshape(HEIGHT_PX, WIDTH_PX)
        for k in range(len(sequence)):
            pipeline.push(side, frames, k)
    pipeline.find_coarse()


def decoded(pipeline: Pipeline) -> int:
    return int(np.count_nonzero(pipeline.decoded("left").mask == Mask.VALID))


def said(pipeline: Pipeline, points: int, *judgements: Judgement) -> EmptyCloud | None:
    cloud = pipeline.table.cloud(CloudLocation(((0, points),), CloudSummary(points, 50.0, 520.0, 0.1, 0.1)))
    return why_empty(pipeline, cloud, judgements)


def test_few_points_whose_rays_meet_are_points_and_none_at_all_were_masked(pipeline: Pipeline) -> None:
    see_wall(pipeline)
    assert decoded(pipeline) > 2000
    assert said(pipeline, 1) is said(pipeline, decoded(pipeline) // 20 + 1, MURKY) is None
    empty = said(pipeline, 0, MURKY)
    assert empty is not None
    assert not empty.by_calibration
    assert f"no points are left of {decoded(pipeline)} decoded pixels ({FaultCode.TOO_DARK.value}" in empty.reason


def test_rays_that_pass_each_other_are_the_calibrations_fault_whatever_the_judges_say(pipeline: Pipeline) -> None:
    see_wall(pipeline, raised_px=16.0)  # 4 mm on the wall
    few = decoded(pipeline) // 20
    assert said(pipeline, few + 1, MURKY) is None, "more than a twentieth is a cloud"
    for points in (0, few):
        empty = said(pipeline, points, MURKY)
        assert empty is not None
        assert empty.by_calibration
        assert empty.reason.startswith(f"{points} points are left of {decoded(pipeline)} decoded pixels: the rays")
        assert "TOO" not in empty.reason
    # Where frames are not their patterns, or no pattern was seen, no calibration is blamed.
    stuck = said(
        pipeline, few, Judgement(Verdict("identity", False), Fault(FaultCode.CAMERA_STUCK, "from frame 19 on"))
    )
    assert stuck is not None
    assert not stuck.by_calibration
    assert f"({FaultCode.CAMERA_STUCK.value}: from frame 19 on)" in stuck.reason
    mask = pipeline.decoded("left").mask
    mask[:] = Mask.SHADOW
    least = -(-mask.size // 1000)  # a thousandth of the picture
    mask.ravel()[: least - 1] = Mask.VALID
    empty = said(pipeline, 0, MURKY, Judgement(Verdict("motion", True)))
    assert empty is not None
    assert not empty.by_calibration
    assert empty.reason.startswith(f"shows no pattern: {least - 1} of {mask.size} pixels")
    assert f"({FaultCode.TOO_DARK.value}: of 2 % of the picture)" in empty.reason
    mask.ravel()[:least] = Mask.VALID
    enough = said(pipeline, 0)
    assert enough is not None
    assert "shows no pattern" not in enough.reason
