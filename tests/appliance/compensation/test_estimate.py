"""The motion of a hand from its frames alone, and the cloud that it would have been at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.compensation.attempt import LEAST_STEP_DEG, Attempt, attempt
from appliance.compensation.displacement import spline_noise_share
from appliance.compensation.estimate import MotionEstimate
from appliance.compensation.redecode import compensate
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.reconstruct.rows import LeftMaps
from appliance.scan.noise import CameraNoise, StereoNoise
from appliance.scan.sides import SIDES, of_side
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, judge_at, recorded, true_motion_mm
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, left_to_rig, true_calibration

ALONG = Motion((18.0, 15.0, 18.6), (120.0, 100.0, 124.0), rotation_deg_s=(2.0, -2.0, 1.5))
"""Nearly with the fringes: a point sees steps of 30° in place of 90°."""
HAND = Motion((6.0, 5.0, 6.2), tremor_mm=(0.2, 0.2, 0.2), rotation_deg_s=(1.0, -1.5, 1.0))


SLOW = Motion((2.0, -1.0, 3.0), tremor_mm=(0.1, 0.1, 0.1))
FRUSTUM = Scene("frustum", texture="strong")


@dataclass(frozen=True)
class Corrected:
    scan: RenderedScan
    plain: Cloud
    motion: MotionEstimate
    said: Attempt
    cloud: Cloud
    """Compensated, also where it is not needed."""
    maps: dict[str, LeftMaps]
    """The maps by side that the compensated cloud was found in."""
    noise: StereoNoise


def corrected(motion: Motion, scene: Scene = FRUSTUM, brightness_sd: float = 0.0) -> Corrected:
    scene = replace(scene, motion=motion)
    scan = render_scan(scene, "modelled", 10_007, 400, 16, frame_s=FRAME_S)
    if brightness_sd:
        share = 1.0 + brightness_sd * np.random.default_rng(3).standard_normal((len(scan.sequence), 1, 1))
        # Both cameras see the same flashes.
        flashing = {
            side: np.clip(np.rint(stack * share), 0, 255).astype(np.uint8) for side, stack in scan.frames.items()
        }
        scan = replace(scan, frames=flashing)
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        for side, frames in scan.frames.items():
            for k in range(len(scan.sequence)):
                pipeline.push(side, frames, k)
        pipeline.find_coarse()
        found = pipeline.find_full(straightened=False)
        plain, taken = pipeline.table.cloud(found), recorded(scan, pipeline)
        said = attempt(pipeline, found, taken, calibration, WATER)
        assert said.motion is not None
        maps = compensate(taken, calibration, WATER, said.motion)
        again = pipeline.find_replaced(maps["left"], maps["right"])
        return Corrected(scan, plain, said.motion, said, pipeline.table.cloud(again), maps, taken.noise)


@pytest.fixture(scope="module")
def moved() -> Corrected:
    return corrected(HAND)


@pytest.fixture(scope="module")
def still() -> Corrected:
    return corrected(Motion())


def test_the_hand_is_found(moved: Corrected) -> None:
    found = moved.motion
    truth = true_motion_mm(moved.scan, np.array(found.frames) * FRAME_S, found.reference_s, found.centre_mm)
    # Among the x-sines, which make the depth, to 2 % of a camera px (0.64 mm) a frame; the y-sines only choose rows.
    assert np.abs(found.motion_mm - truth)[:4].max() < 0.04
    assert np.abs(found.motion_mm - truth)[4:].max() < 0.3
    assert found.converged
    assert found.ripple_before > 2.0
    assert found.ripple_after < 0.6


def test_its_cloud_is_nearly_that_of_a_scan_at_rest(moved: Corrected, still: Corrected) -> None:
    at_rest = judge_at(still.scan, still.plain, 0.0)
    plain = judge_at(moved.scan, moved.plain, moved.motion.reference_s)
    after = judge_at(moved.scan, moved.cloud, moved.motion.reference_s)
    assert plain.rms_mm > 1.6 * at_rest.rms_mm
    assert after.rms_mm < 1.2 * at_rest.rms_mm
    assert after.completeness_percent > 0.9 * plain.completeness_percent


def test_single_pixels_that_compensation_leaves_out_do_not_make_a_good_scan_bad() -> None:
    """A plain shell under a steady hand, half as noisy as at rest, was refused: beside each missing pixel an object's edge was supposed."""
    hand = corrected(HAND, Scene("shell", texture="none"))
    assert hand.said.found is not None, hand.said.why
    assert hand.said.error_after is not None
    assert hand.said.error_after < 1.0


def test_printed_squares_under_a_slow_hand_are_not_made_worse() -> None:
    # The plain cloud has no point at most borders of the squares; the compensated one must not fill them with bad ones.
    squares = corrected(SLOW, Scene("shell", texture="checker"))
    plain, after = (judge_at(squares.scan, c, squares.motion.reference_s) for c in (squares.plain, squares.cloud))
    assert after.rms_mm < plain.rms_mm
    assert after.completeness_percent > 0.85 * plain.completeness_percent


def in_sigmas(one: Corrected) -> float:
    """Root mean square error in units of the points' own sigmas, without the worst three in a thousand."""
    surface = one.scan.renderer.surface(one.motion.reference_s)
    error = surface.distance_mm(left_to_rig(one.scan.renderer.truth, one.cloud.points_mm)) / one.cloud.sigma_mm
    return float(np.sqrt(np.mean(np.sort(error**2)[: int(0.997 * len(error))])))


def test_points_know_how_good_they_are_after_compensation(moved: Corrected) -> None:
    # Never better than they are; at this size looking up borders of paint makes them rather too cautious.
    assert 0.45 < in_sigmas(moved) < 1.25


def test_compensated_points_have_the_modulation_that_the_camera_saw(moved: Corrected) -> None:
    width, px = moved.scan.frames["left"].shape[2], np.intersect1d(moved.plain.pixel, moved.cloud.pixel)
    assert len(px) > 0.8 * len(moved.plain.pixel)
    before, after = (cloud.modulation_dn[np.searchsorted(cloud.pixel, px)] for cloud in (moved.plain, moved.cloud))
    # Cameras and projector share the field: the cubic B-spline keeps sinc⁴ of fringes that are so long.
    kept = float(np.sinc(moved.scan.sequence.width_px / (16.0 * width)) ** 4)
    assert np.median(after / before) == pytest.approx(kept, rel=0.05)


def four_steps_px2(maps: LeftMaps, noise: CameraNoise, at: tuple[np.ndarray, ...] | np.ndarray) -> np.ndarray:
    """The variance of coordinates by four steps of 90° of 16 px in the same light: (P/2π)² σ² / (2 B²)."""
    modulation, offset = 0.5 * maps.modulation_half_dn[at].astype(float), maps.gray_threshold[at].astype(float)
    by_camera = noise.read_dn**2 + noise.dn_per_e * (offset - noise.black_dn)
    return np.asarray((16.0 / (2.0 * np.pi)) ** 2 * by_camera / (2.0 * modulation**2))


def test_at_rest_the_maps_carry_the_variance_of_four_steps_in_the_share_that_reading_between_pixels_leaves(
    still: Corrected,
) -> None:
    # What the motion may have left of ripple counts everywhere.
    share = float(spline_noise_share(np.float32(8.0), np.float32(8.0))) * (1.0 + still.motion.ripple_after**2)
    for side in SIDES:
        maps = still.maps[side]
        known = np.isfinite(maps.p_px)
        ratio = maps.variance_px2[known] / four_steps_px2(maps, of_side(still.noise, side), known)
        assert np.median(ratio) == pytest.approx(share, rel=0.03)


def test_what_is_expected_is_the_deviation_of_points_over_what_they_had_been_expected_to_have_at_rest(
    moved: Corrected,
) -> None:
    common, plain, after = np.intersect1d(moved.plain.pixel, moved.cloud.pixel, return_indices=True)
    width = moved.scan.frames["left"].shape[2]
    # Beside a missing pixel, sigma supposes an object's edge.
    inside = np.logical_and.reduce([np.isin(common.astype(np.int64) + step, common) for step in (-width, -1, 1, width)])
    over = np.sqrt(
        np.mean(moved.cloud.sigma_mm[after[inside]] ** 2) / np.mean(moved.plain.sigma_mm[plain[inside]] ** 2)
    )
    assert moved.said.error_after == pytest.approx(float(over), rel=1e-4)


@pytest.mark.dive
def test_compensated_scans_that_err_more_than_a_fifth_beyond_one_at_rest_are_refused_with_the_reason(
    still: Corrected,
) -> None:
    """Borders of printed squares, and a hand that nearly goes along with the fringes: their median points are as good as at rest."""
    squares = Scene("shell", texture="checker")
    for hand, scene, rest in ((SLOW, squares, corrected(Motion(), squares)), (ALONG, FRUSTUM, still)):
        worse = corrected(hand, scene)
        at_rest = judge_at(rest.scan, rest.plain, 0.0).rms_mm
        assert judge_at(worse.scan, worse.cloud, worse.motion.reference_s).rms_mm > 1.2 * at_rest
        assert worse.said.found is None
        assert "times as at rest" in worse.said.why
        assert "up to 1.2" in worse.said.why


def test_a_hand_along_the_fringes_leaves_far_less_noise_than_points_followed_all_the_way(still: Corrected) -> None:
    along = corrected(ALONG)
    at_rest = judge_at(still.scan, still.plain, 0.0)
    before = judge_at(along.scan, along.plain, along.motion.reference_s)
    after = judge_at(along.scan, along.cloud, along.motion.reference_s)
    assert along.motion.noise_factor > 3.0, "what following all the way would make of it"
    assert after.rms_mm < 2.5 * at_rest.rms_mm
    assert after.rms_mm < 0.4 * before.rms_mm
    assert in_sigmas(along) < 1.5, "whatever it is, sigma tells"


def test_brightness_from_frame_to_frame_at_rest_is_no_motion() -> None:
    flashes = corrected(Motion(), brightness_sd=0.015)
    assert not flashes.motion.moved
    assert flashes.said.found is None
    assert flashes.said.why == "Nothing moved that would show."


def test_who_outruns_the_fringes_has_to_repeat() -> None:
    said = corrected(Motion((80.0, 0.0, 0.0))).said
    assert said.found is None
    assert said.motion is not None
    # Phases advance by 90° from image to image; points that follow the fringes see them stand still, or go back.
    assert said.motion.step_deg < LEAST_STEP_DEG


def test_a_scan_at_rest_is_not_made_worse(still: Corrected) -> None:
    before, after = judge_at(still.scan, still.plain, 0.0), judge_at(still.scan, still.cloud, 0.0)
    assert np.abs(still.motion.motion_mm)[:4].max() < 0.04
    assert still.motion.ripple_before < 0.5
    assert still.motion.step_deg == pytest.approx(90.0, abs=1.0)
    assert still.said.found is None
    assert after.rms_mm < 1.03 * before.rms_mm
    assert after.completeness_percent > before.completeness_percent - 1.0
