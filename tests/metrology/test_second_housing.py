"""A second housing measures by its rig file alone: baseline 120 mm, at 300 mm, with a projector of 1280 × 720; in small pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.cli.simtruth import true_calibration
from appliance.config import Rig, load_rig
from appliance.instrument import design_of, exposure_of, live_light_of, machine_settings, settings_of, volume_of
from appliance.optics.volume import STANDARD
from appliance.patterns.sequence import DARK_CODE, PatternSequence, build_sequence
from appliance.processing.procedure import FullFound, SequenceProcessor
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.fault import FaultCode
from hw_sim.options import options_from
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.truth import TrueRig
from hw_sim.world import true_rig
from tests.support.rendered import pictures
from tests.support.truth import WATER, left_to_rig

pytestmark = pytest.mark.devices

Frames = Mapping[str, NDArray[np.uint8]]


@dataclass(frozen=True)
class Taken:
    """A scan of the simulated world, and what is true of it."""

    rig: Rig
    truth: TrueRig
    renderer: Renderer
    sequence: PatternSequence
    frames: Frames

    def found(self, frames: Frames, calibration: Calibration) -> tuple[FullFound, NDArray[np.float32]]:
        """Return what the procedure makes of ``frames``, and the points (n, 3) mm in the left camera's frame."""
        with Pipeline(calibration, WATER, self.sequence) as pipeline:
            processor = SequenceProcessor(pipeline, calibration, WATER)
            processor.begin(settings_of(self.rig, exposure_of(self.rig)))
            assert len(list(processor.push_all(frames))) == len(self.sequence)
            full = processor.run()
            assert full is not None
            return full, pipeline.table.cloud(full.found).points_mm


@cache
def rig_of(thing: str) -> Rig:
    """Return the rig file of the second housing, before ``thing`` and with small pictures."""
    options = SimOptions(object_name=thing, texture="slight", truth="nominal", size="480x300")
    return simulated(load_rig(default_sim_rig().with_name("compact.toml")), options)


@cache
def taken(thing: str) -> Taken:
    rig = rig_of(thing)
    truth = true_rig(rig.rig.wires_options)
    renderer = Renderer(truth, options_from(rig.rig.wires_options).scene())
    sequence = build_sequence(rig.scan.period_px, rig.projector.width_px, rig.projector.height_px)
    time_s = 1e-3 * rig.camera.left.exposure_ms
    frames = {
        side: np.stack(
            [
                renderer.expose(
                    side, [LightSlice(shown, time_s)], 0.0, time_s, 0.0, (False, False), 2 * k + number, k / 60
                )
                for k, shown in enumerate(pictures(sequence))
            ]
        )
        for number, side in enumerate(("left", "right"))
    }
    return Taken(rig, truth, renderer, sequence, frames)


@pytest.mark.parametrize("thing", ["plane", "pipe"])
def test_points_lie_on_the_true_surface_and_no_judge_objects(thing: str) -> None:
    scan = taken(thing)
    assert len(scan.sequence) == machine_settings(scan.rig).frames[16] == 25
    full, points = scan.found(scan.frames, true_calibration(scan.rig))
    off_mm = scan.renderer.surface(0.0).distance_mm(left_to_rig(scan.truth, points))
    assert len(points) > 60_000
    assert float(np.sqrt(np.mean(off_mm**2))) < 0.03
    assert [one.fault.code for one in full.judgements if one.fault is not None] == []
    assert {one.verdict.name: one.verdict.passed for one in full.judgements}["sides"] is True


def test_in_the_standard_volume_it_would_have_no_point() -> None:
    scan = taken("plane")
    exact = true_calibration(scan.rig)
    assert exact.rig.volume == volume_of(scan.rig) != STANDARD
    full, points = scan.found(scan.frames, replace(exact, rig=replace(exact.rig, volume=STANDARD)))
    assert len(points) == 0
    assert FaultCode.SCAN_NEAR in [one.fault.code for one in full.judgements if one.fault is not None]


def test_its_drawing_is_what_the_world_was_built_to() -> None:
    """Stated twice, once for the program and once for the world: where they differ, lengths would be wrong."""
    rig = rig_of("plane")
    drawn, true = design_of(rig).rig, true_calibration(rig).rig
    for mine, its in ((drawn.left, true.left), (drawn.right, true.right)):
        assert mine.lens.f_px == pytest.approx(its.lens.f_px)
        assert (mine.lens.c_px, mine.port) == (its.lens.c_px, its.port)
    np.testing.assert_allclose(drawn.right.translation_mm, true.right.translation_mm, atol=1e-9)
    np.testing.assert_allclose(drawn.right.rotation, true.right.rotation, atol=1e-9)


def test_exchanged_cameras_are_named_with_the_drawing_alone() -> None:
    scan = taken("plane")
    exchanged = {"left": scan.frames["right"], "right": scan.frames["left"]}
    full, _ = scan.found(exchanged, design_of(scan.rig))
    assert [one.fault.code for one in full.judgements if one.fault is not None] == [FaultCode.SIDES_EXCHANGED]


def test_its_live_light_is_dark_where_its_own_dots_fall() -> None:
    light = live_light_of(rig_of("plane"))
    assert light.shape == (720, 1280)
    assert 0.01 < float(np.mean(light == DARK_CODE)) < 0.25
