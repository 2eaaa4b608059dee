"""The scenes of the world ``outside`` as the benchmark sees them: the rig that belongs to them, their frames, their true calibration."""

from __future__ import annotations

from importlib import resources
from tomllib import loads

import numpy as np
import pytest

from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure
from bench.outside.stated import stated_truth
from bench.outside.world import STEPS, TRIGGER_DELAY_US, chosen_exposure, expose, world_of
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from tests.support.truth import true_calibration

TINY_PX = 80, 60
SEQUENCE = build_sequence(16)


def test_frames_begin_when_the_instruments_rig_file_says() -> None:
    board = loads(resources.files("appliance.rigs").joinpath("kingfisher.toml").read_text(encoding="utf-8"))["board"]
    assert board["trigger_delay_us"] == TRIGGER_DELAY_US


def test_a_family_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ValueError, match="family 'fog'; allowed are backscatter"):
        world_of(Scene(), 10_001, ("fog",))


def test_without_families_it_is_the_ordinary_world() -> None:
    world = world_of(Scene(), 10_001, (), size_px=TINY_PX)
    assert world.rig == draw_truth("realistic", 10_001, *TINY_PX, world.scene.water.index)


def test_the_rig_is_that_of_the_leds_colour_and_of_the_cases_warmth() -> None:
    green, other = (world_of(Scene(), 10_001, families, size_px=TINY_PX) for families in ((), ("projector",)))
    assert other.rig.n_water == other.scene.index != green.rig.n_water
    assert other.rig.left.port.n_g != green.rig.left.port.n_g
    warm = world_of(Scene(), 10_001, ("mounts",), size_px=TINY_PX, case_c=45.0)
    assert warm.rig.left.R != green.rig.left.R


def test_bits_of_a_frame_depend_on_when_the_exposure_begins() -> None:
    renderer = world_of(Scene(object="plane", noise=False), 10_001, ("projector",), size_px=TINY_PX).renderer()
    sine = SEQUENCE.axis(Direction.X).sine[0]
    early, late = (
        expose(renderer, SEQUENCE, Exposure(2_000), only=[sine], trigger_delay_us=delay)["left"].astype(float)
        for delay in (500, 1_500)
    )
    # White has all bits and is the same at any time of a frame; grey is not.
    ratio = late[early > 20.0] / early[early > 20.0]
    assert ratio.std() > 0.03


def test_the_best_calibration_of_a_flawed_rig_follows_its_rays_to_a_micrometre() -> None:
    world = world_of(Scene(), 10_002, size_px=TINY_PX, case_c=40.0)
    stated = stated_truth(world.rig, world.scene)
    assert stated.left_um < 1.0
    assert stated.water.index == pytest.approx(world.scene.index, abs=1e-9)
    # What its formulas alone would say is hundreds of times worse.
    off_px = stated.calibration.rig.left.project(np.array([[0.0, 0.0, 520.0]]), stated.water.index)
    plain_px = true_calibration(world.rig).rig.left.project(np.array([[0.0, 0.0, 520.0]]), stated.water.index)
    assert np.abs(off_px - plain_px).max() > 0.001


def test_the_exposure_is_one_that_the_instrument_would_propose() -> None:
    renderer = world_of(Scene(object="plane"), 10_003, ("cameras",), size_px=TINY_PX).renderer()
    chosen = chosen_exposure(renderer, SEQUENCE)
    assert chosen in STEPS
    top = [expose(renderer, SEQUENCE, chosen, only=[SEQUENCE.bright])[side].max() for side in ("left", "right")]
    assert 140 < max(top) <= 255
