"""A movement is refused when it harms the points, named when it does not, and never found where nothing moves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.measure.fault import FaultCode
from appliance.measure.verdicts.motion.judge import MotionJudgement, MotionKind
from appliance.measure.verdicts.motion.scores import MOVED
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from tests.support.judged import judge_frames, record
from tests.support.moved import FRAME_S
from tests.support.rendered import render_scan
from tests.support.truth import true_calibration

STILL, AWAY = Motion(), Motion(velocity_mm_s=(0.0, 0.0, -8.0))
TILTED = (0.0, 0.0, 522.5, 8.0, 12.0, 0.0)
FACING = (0.0, 0.0, 522.5, 0.0, 0.0, 0.0)
STEADY = Daylight()
HEIGHT_PX = 100
"""Of the strip in the middle that is rendered: a third of the picture tells as much of a movement."""


@cache
def clean(
    motion: Motion,
    texture: str = "slight",
    pose: tuple[float, float, float, float, float, float] = TILTED,
    response: str = "measured",
    light: Daylight = STEADY,
) -> dict[str, np.ndarray]:
    scene = Scene(
        object="plane", pose=pose, texture=texture, noise=False, motion=motion, imaging=Imaging(response), ambient=0.1,
        daylight=light,
    )  # fmt: skip
    return dict(render_scan(scene, "modelled", 3, 400, 16, height_px=HEIGHT_PX, frame_s=FRAME_S).frames)


def judge(frames: dict[str, np.ndarray], gain_db: float = 0.0) -> MotionJudgement:
    calibration = true_calibration(draw_truth("modelled", 3, 400, HEIGHT_PX, Water().index))
    return judge_frames(record(frames, gain_db, 3, 5), calibration, 16, gain_db, 0.012)


@pytest.mark.parametrize(
    ("texture", "response", "gain_db", "light"),
    [
        ("slight", "measured", 0.0, STEADY),
        ("checker", "gamma", 12.0, STEADY),
        ("slight", "measured", 0.0, Daylight(flicker_depth=0.9, flicker_hz=2.0)),
    ],
)
def test_what_stands_still_passes_in_any_light(texture: str, response: str, gain_db: float, light: Daylight) -> None:
    said = judge(clean(STILL, texture, TILTED, response, light), gain_db)
    assert (said.judgement.verdict.passed, said.judgement.fault, said.kind) == (True, None, MotionKind.STILL)
    assert 0.0 < (said.scores.largest or 0.0) < MOVED
    assert said.added is not None
    assert said.added < 0.02


def test_moving_away_is_refused_with_its_speed() -> None:
    said = judge(clean(AWAY))
    assert said.judgement.verdict.passed is False
    fault = said.judgement.fault
    assert fault is not None
    assert fault.code is FaultCode.MOVED
    # The rig goes back, so that the surface recedes, along slanted rays of a tilted surface.
    assert said.axial_mm_s == pytest.approx(8.0, rel=0.12)
    assert fault.numbers["speed_mm_s"] == pytest.approx(8.0, rel=0.25)
    assert said.kind is MotionKind.AXIAL
    assert said.place is not None
    assert said.place.word == "everywhere"
    # The fringes move over the image by as much as the depth tells: 0.0144 pattern px per frame and mm/s.
    assert np.nanmedian(np.abs(said.drift["left"].drift_px)) == pytest.approx(0.0144 * 8.0, rel=0.15)


def test_moving_away_before_a_projector_whose_light_is_a_sine_is_named_and_kept() -> None:
    said = judge(clean(Motion(velocity_mm_s=(0.0, 0.0, -20.0)), "none", response="linear"))
    assert (said.judgement.verdict.passed, said.kind) == (True, MotionKind.AXIAL)
    assert said.axial_mm_s == pytest.approx(20.0, rel=0.12)
    assert said.added is not None
    assert said.added < 0.05, "what a drift leaks into the mean light is no texture"
    # Other judges see the drift none the less.
    assert (said.judgement.verdict.numbers["drift_over_noise"] or 0.0) > 1.0


def test_a_shake_that_turns_round_is_refused_although_it_hardly_drifts() -> None:
    said = judge(clean(Motion(tremor_mm=(0.0, 0.0, 0.4), tremor_hz=6.0), "none", response="linear"))
    assert said.judgement.verdict.passed is False
    assert (said.added or 0.0) > 0.5


def test_sliding_along_a_facing_plane_is_named_and_kept() -> None:
    said = judge(clean(Motion(velocity_mm_s=(6.0, 0.0, 0.0)), pose=FACING))
    assert said.kind is MotionKind.LATERAL
    assert said.lateral_mm_s is not None
    # The rig goes right, so that the paint goes left.
    assert said.lateral_mm_s == pytest.approx((-6.0, 0.0), abs=0.9)
    assert said.judgement.verdict.passed


def test_a_turn_is_a_slope_of_the_drift() -> None:
    said = judge(clean(Motion(rotation_deg_s=(0.0, 5.0, 0.0))))
    assert said.kind is MotionKind.ROTATION
    rate = said.harm.depth_rate_mm_s
    known = np.isfinite(rate) & (said.harm.weight > 0)
    x_mm = (said.harm.u_px[known] - 199.5) * 0.64
    assert abs(np.polyfit(x_mm, rate[known], 1)[0]) == pytest.approx(np.radians(5.0), rel=0.2)


def test_something_else_that_moves_is_named_with_its_place() -> None:
    """In the upper right quarter stands what moves; all else is at rest."""
    mixed = {side: frames.copy() for side, frames in clean(STILL).items()}
    for side, moving in clean(AWAY).items():
        mixed[side][:, 7:53, 230:320] = moving[:, 7:53, 230:320]
    said = judge(mixed)
    assert said.kind is MotionKind.LOCAL
    assert said.place is not None
    assert said.place.word == "upper right"
    assert said.place.u_px == pytest.approx(275.0, abs=45.0)
    assert said.place.v_px == pytest.approx(30.0, abs=24.0)


def test_where_nothing_is_lit_nothing_is_judged() -> None:
    said = judge({side: np.full((24, HEIGHT_PX, 400), 3, np.uint8) for side in ("left", "right")})
    assert (said.judgement.verdict.passed, said.judgement.fault, said.added) == (None, None, None)
