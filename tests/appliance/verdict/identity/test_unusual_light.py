"""An object outside of the volume, a lamp and a short exposure are no fault of patterns, cameras or projector: they came as WRONG
PATTERN, LCAM STUCK and PROJECTOR DARK."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.verdict.identity.judge import judge_identity
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support.rendered import RenderedScan, render_scan


@pytest.fixture(scope="module")
def near() -> RenderedScan:
    """A pipe's front at 345 mm, in water that keeps it from being saturated."""
    scene = Scene(object="pipe", pose=(0.0, 0.0, 370.0, 0.0, 6.0, 20.0), texture="strong", water=turbid(2.0))
    return render_scan(scene, "realistic", 5, 400, 16)


def test_stripes_that_parallax_displaces_are_no_wrong_pattern(near: RenderedScan) -> None:
    judged = judge_identity(near.frames, near.sequence)
    assert judged.fault is None
    assert judged.verdict.passed is None


def test_a_wrong_gray_image_is_found_before_a_near_object_as_well(near: RenderedScan) -> None:
    """The fourth Gray image is the third once more, in both cameras."""
    frames = {side: stack.copy() for side, stack in near.frames.items()}
    gray = near.sequence.axis(Direction.X).gray
    for stack in frames.values():
        stack[gray[3]] = stack[gray[2]]
    judged = judge_identity(frames, near.sequence)
    assert judged.fault is not None


@pytest.mark.parametrize(
    ("thing", "seed", "exposure_s"), [("plane", 10_600, 0.03), ("plane", 10_600, 0.12), ("stones", 5, 0.064)]
)
def test_what_is_too_near_and_saturated_is_no_wrong_pattern(thing: str, seed: int, exposure_s: float) -> None:
    """What is clear in it are borders of the picture and of stripes: these came as WRONG PATTERN."""
    scene = Scene(thing, pose=(0.0, 0.0, 330.0, 4.0, 12.0, 0.0), texture="slight")
    scan = render_scan(scene, "realistic", seed, 200, 32, exposure_s, height_px=150)
    bright = scan.frames["left"][scan.sequence.bright]
    assert np.mean(bright[bright > 60] == 255) > 0.8
    assert judge_identity(scan.frames, scan.sequence).fault is None


@pytest.mark.parametrize("gain", [8, 20])
def test_a_wrong_gray_image_is_found_in_a_picture_of_which_most_is_saturated(near: RenderedScan, gain: int) -> None:
    frames = {
        side: np.clip(gain * stack.astype(np.int64), 0, 255).astype(np.uint8) for side, stack in near.frames.items()
    }
    assert judge_identity(frames, near.sequence).fault is None
    gray = near.sequence.axis(Direction.X).gray
    for stack in frames.values():
        stack[gray[4]] = stack[gray[3]]
    judged = judge_identity(frames, near.sequence)
    assert judged.fault is not None
    assert judged.fault.code is FaultCode.PATTERN_WRONG


def test_a_lamp_that_blinds_a_camera_does_not_make_it_stuck() -> None:
    scene = replace(Scene(texture="strong"), ambient=3.0)
    scan = render_scan(scene, "realistic", 5, 400, 16)
    assert float(np.mean(scan.frames["left"].min(axis=0) == 255)) > 0.05
    assert judge_identity(scan.frames, scan.sequence).fault is None


def lit_by_lamp(frames: NDArray[np.uint8] | NDArray[np.float64], swing_dn: float, hz: float = 3.1) -> NDArray[np.uint8]:
    """The same before a lamp that adds up to twice ``swing_dn`` everywhere, frame by frame at 60 a second."""
    added = swing_dn * (1.0 + np.cos(2.0 * np.pi * hz * np.arange(len(frames)) / 60.0))
    return np.asarray(np.clip(np.rint(frames + added[:, None, None]), 0, 255), np.uint8)


def test_a_flickering_lamp_before_an_object_that_is_too_near_makes_no_projector_dark(near: RenderedScan) -> None:
    """The mean of the frames says nothing of the projector then: a lamp of 3 Hz before a far plane was PROJECTOR DARK."""
    frames = {side: lit_by_lamp(stack, 10.0) for side, stack in near.frames.items()}
    judged = judge_identity(frames, near.sequence)
    assert judged.verdict.numbers["left_samples"] == 0.0, "the stripes are displaced: nothing is left to be judged"
    assert judged.fault is None


@pytest.mark.parametrize(
    ("time_us", "expected"), [(200, None), (2_000, FaultCode.PROJECTOR_DARK), (12_000, FaultCode.PROJECTOR_DARK)]
)
def test_only_an_exposure_that_shows_lit_water_can_tell_that_the_projector_is_dark(
    time_us: int, expected: FaultCode | None
) -> None:
    """0.2 ms before nothing, or into thick water, was PROJECTOR DARK: a hundredth of a grey value of veil is not seen."""
    sequence = build_sequence(16, 128, 96)
    rng = np.random.default_rng(7)
    black = {
        side: np.clip(np.rint(2.0 + 0.5 * rng.standard_normal((len(sequence), 144, 192))), 0, 255).astype(np.uint8)
        for side in ("left", "right")
    }
    fault = judge_identity(black, sequence, exposure=Exposure(time_us)).fault
    assert (None if fault is None else fault.code) is expected


def test_a_dark_projector_before_a_flickering_lamp_is_not_told_from_nothing_in_reach() -> None:
    """The lamp's changes are many times what lit water adds, so that its absence says nothing; the diver hears NOTHING SEEN, IS LIGHT COVERED?"""
    sequence = build_sequence(16, 128, 96)
    rng = np.random.default_rng(8)
    dark = 2.0 + 0.5 * rng.standard_normal((len(sequence), 144, 192))
    frames = {side: lit_by_lamp(dark, 1.5) for side in ("left", "right")}
    assert judge_identity(frames, sequence).fault is None
