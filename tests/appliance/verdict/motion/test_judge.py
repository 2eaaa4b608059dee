"""A movement is refused when it harms the points, named when it does not, and never found where nothing moves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.scan.fault import FaultCode
from appliance.verdict.motion.judge import MotionJudgement, MotionKind
from appliance.verdict.motion.scores import MOVED
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from tests.support.judged import judge_frames, record
from tests.support.moved import FRAME_S
from tests.support.rendered import render_scan
from tests.support.truth import true_calibration

STILL = Motion()
TILTED = (0.0, 0.0, 522.5, 8.0, 12.0, 0.0)
FACING = (0.0, 0.0, 522.5, 0.0, 0.0, 0.0)
STEADY = Daylight()
HEIGHT_PX = 200
"""Of the strip in the middle that is rendered: two thirds of the picture tell as much of a movement."""


@cache
def clean(
    motion: Motion,
    texture: str,
    pose: tuple[float, float, float, float, float, float],
    thing: str,
    response: str,
    light: Daylight,
) -> dict[str, np.ndarray]:
    scene = Scene(
        object=thing, pose=pose, texture=texture, noise=False, motion=motion, imaging=Imaging(response), ambient=0.1,
        daylight=light,
    )  # fmt: skip
    return dict(render_scan(scene, "modelled", 3, 400, 16, height_px=HEIGHT_PX, frame_s=FRAME_S).frames)


def judge(
    motion: Motion = STILL,
    texture: str = "slight",
    pose: tuple[float, ...] = TILTED,
    thing: str = "plane",
    response: str = "measured",
    frames: dict[str, np.ndarray] | None = None,
    gain_db: float = 0.0,
    light: Daylight = STEADY,
) -> MotionJudgement:
    frames = frames or clean(motion, texture, pose, thing, response, light)
    calibration = true_calibration(draw_truth("modelled", 3, 400, HEIGHT_PX, Water().index))
    return judge_frames(record(frames, gain_db, 3, 5), calibration, 16, gain_db, 0.012)


@pytest.mark.parametrize(
    ("thing", "texture", "response", "gain_db", "light"),
    [
        ("plane", "slight", "measured", 0.0, STEADY),
        ("plane", "checker", "gamma", 12.0, STEADY),
        ("plane", "slight", "measured", 0.0, Daylight(flicker_depth=0.9, flicker_hz=2.0)),
        pytest.param(
            "plane", "slight", "measured", 6.0, Daylight(flicker_depth=0.9, flicker_hz=119.9), marks=pytest.mark.long
        ),
        pytest.param(
            "stones", "strong", "gamma", 0.0, Daylight(flicker_depth=0.5, flicker_hz=1.0), marks=pytest.mark.long
        ),
    ],
)
def test_what_stands_still_passes_in_any_light(
    thing: str, texture: str, response: str, gain_db: float, light: Daylight
) -> None:
    pose = TILTED if thing == "plane" else (0, 0, 535, 0, 0, 0)
    said = judge(STILL, texture, pose, thing, response, gain_db=gain_db, light=light)
    assert said.judgement.verdict.passed
    assert said.judgement.fault is None
    assert said.kind is MotionKind.STILL
    assert said.scores.largest is not None
    assert said.scores.largest < MOVED
    assert said.added is not None
    assert said.added < 0.02


def test_moving_away_is_refused_with_its_speed() -> None:
    said = judge(Motion(velocity_mm_s=(0.0, 0.0, -8.0)))
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
    half = np.nanmedian(np.abs(said.drift["left"].drift_px))
    assert half == pytest.approx(0.0144 * 8.0, rel=0.15)


def test_a_projector_that_is_no_straight_line_hides_no_movement() -> None:
    """The second harmonic of its light takes a fifth of the drift's signs, and makes the ripple larger."""
    motion = Motion(velocity_mm_s=(0.0, 0.0, -8.0))
    bent, straight = judge(motion, "none", response="gamma"), judge(motion, "none", response="linear")
    assert bent.axial_mm_s == pytest.approx(straight.axial_mm_s, rel=0.08)
    assert bent.harm.ripple_rms_mm is not None
    assert straight.harm.ripple_rms_mm is not None
    assert bent.harm.ripple_rms_mm > 1.15 * straight.harm.ripple_rms_mm


@pytest.mark.long
def test_shaking_paint_is_followed_frame_by_frame() -> None:
    """Six millimetres per second to and fro at 11 Hz: no mean of several images would show it."""
    hz, tremor_mm = 11.0, 0.09
    said = judge(Motion(tremor_mm=(tremor_mm, 0.0, 0.0), tremor_hz=hz), "strong", FACING)
    seen = said.albedo["left"].shift_px[:, 0]
    known = np.isfinite(seen)
    assert np.count_nonzero(known) >= 12
    time_s = np.flatnonzero(known) * FRAME_S
    # A rig that goes right sees everything go left: 0.64 mm per px here.
    expected = -tremor_mm * np.sin(2.0 * np.pi * hz * time_s) / 0.64
    assert np.corrcoef(seen[known], expected)[0, 1] > 0.97
    assert np.std(seen[known]) == pytest.approx(np.std(expected), rel=0.25)


def test_harmless_movement_is_seen_and_kept() -> None:
    said = judge(Motion(velocity_mm_s=(0.0, 0.0, 0.8)))
    assert said.judgement.verdict.passed
    assert said.axial_mm_s == pytest.approx(-0.8, rel=0.2)
    assert said.kind is not MotionKind.STILL
    assert said.scores.drift is not None
    assert said.scores.drift > MOVED


def test_the_same_movement_harms_a_dark_scan_less() -> None:
    """Harm is measured against noise: with four times of it, what spoils a good scan no longer matters."""
    motion = Motion(velocity_mm_s=(0.0, 0.0, 2.6))
    bright, noisy = judge(motion), judge(motion, gain_db=14.0)
    assert bright.judgement.verdict.passed is False
    assert noisy.judgement.verdict.passed is True


def test_sliding_along_a_facing_plane_is_named_and_kept() -> None:
    said = judge(Motion(velocity_mm_s=(6.0, 0.0, 0.0)), "slight", FACING)
    assert said.kind is MotionKind.LATERAL
    assert said.lateral_mm_s is not None
    # The rig goes right, so that the paint goes left.
    assert said.lateral_mm_s == pytest.approx((-6.0, 0.0), abs=0.9)
    assert said.judgement.verdict.numbers["right_mm_s"] == said.lateral_mm_s[0]
    assert said.judgement.verdict.passed


def test_sliding_along_a_bare_facing_plane_cannot_be_seen_and_does_no_harm() -> None:
    said = judge(Motion(velocity_mm_s=(15.0, 0.0, 0.0)), "none", FACING)
    assert said.lateral_mm_s is None
    assert said.judgement.verdict.passed
    assert said.added is not None
    assert said.added < 0.05


@pytest.mark.long
def test_sliding_along_a_tilted_plane_moves_its_depth() -> None:
    """The same speed over the same paint: what differs is the slope, 0.21 of it becomes depth."""
    said = judge(Motion(velocity_mm_s=(20.0, 0.0, 0.0)), "none")
    assert said.judgement.verdict.passed is False


def test_a_turn_is_a_slope_of_the_drift() -> None:
    said = judge(Motion(rotation_deg_s=(0.0, 5.0, 0.0)))
    assert said.judgement.verdict.passed is False
    assert said.kind is MotionKind.ROTATION
    rate = said.harm.depth_rate_mm_s
    known = np.isfinite(rate) & (said.harm.weight > 0)
    x_mm = (said.harm.u_px[known] - 199.5) * 0.64
    slope = np.polyfit(x_mm, rate[known], 1)[0]
    assert abs(slope) == pytest.approx(np.radians(5.0), rel=0.2)


@pytest.mark.long
def test_shaking_is_told_from_steady_movement() -> None:
    said = judge(Motion(tremor_mm=(0.0, 0.0, 0.35), tremor_hz=6.0))
    assert said.kind is MotionKind.TREMOR


def test_something_else_that_moves_is_named_with_its_place() -> None:
    """In the upper right quarter stands what moves; all else is at rest."""
    still = clean(STILL, "slight", TILTED, "plane", "measured", STEADY)
    moving = clean(Motion(velocity_mm_s=(0.0, 0.0, -8.0)), "slight", TILTED, "plane", "measured", STEADY)
    mixed = {side: frames.copy() for side, frames in still.items()}
    for side in mixed:
        mixed[side][:, 10:80, 230:320] = moving[side][:, 10:80, 230:320]
    said = judge(frames=mixed)
    assert said.kind is MotionKind.LOCAL
    assert said.place is not None
    assert said.place.word == "upper right"
    assert said.place.u_px == pytest.approx(275.0, abs=45.0)
    assert said.place.v_px == pytest.approx(45.0, abs=35.0)


def test_where_nothing_is_lit_nothing_is_judged() -> None:
    dark = {side: np.full((24, HEIGHT_PX, 400), 3, np.uint8) for side in ("left", "right")}
    said = judge(frames=dark)
    assert said.judgement.verdict.passed is None
    assert said.judgement.fault is None
    assert said.added is None
