"""From images: whatever is scanned, in whatever water, no alarm; a knocked camera or salt taken for fresh, an alarm."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.calibrate.health import HealthTrend, judge_health
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.points.pipeline import Pipeline
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth
from hw_sim.water.medium import Water
from tests.support.rendered import EXPOSURE_S, pictures
from tests.support.truth import WATER, true_calibration

SEQUENCE = build_sequence(16)
PICTURES = pictures(SEQUENCE)
TURBID = Water(attenuation_per_m=1.2, backscatter=0.08, blur_px_per_m=1.0)


class Instrument:
    """A true rig, and the pipeline of the calibration it had before anything happened to it."""

    def __init__(self, truth: TrueRig) -> None:
        self.truth = truth
        self._pipeline = Pipeline(true_calibration(truth), WATER, SEQUENCE)
        self._shots = 0

    def scan(self, scene: Scene, truth: TrueRig | None = None) -> PatchGaps:
        """Rendered, decoded and matched as on the instrument; ``truth`` where it has changed."""
        renderer = Renderer(truth or self.truth, scene)
        self._pipeline.reset()
        for side in SIDES:
            shots = []
            for picture in PICTURES:
                light, self._shots = [LightSlice(picture, EXPOSURE_S)], self._shots + 1
                shots.append(renderer.expose(side, light, 0.0, EXPOSURE_S, 0.0, (False, False), self._shots))
            frames = np.stack(shots)
            for k in range(len(SEQUENCE)):
                self._pipeline.push(side, frames, k)
        self._pipeline.find_coarse()
        gaps = self._pipeline.find_full().gaps
        assert gaps is not None
        return gaps


NORMAL = (
    Scene("pipe", pose=(30.0, -20.0, 480.0, 15.0, -10.0, 40.0), texture="slight", ambient=0.05),
    Scene("shell", pose=(-35.0, 25.0, 560.0, -18.0, 12.0, -50.0), texture="none", water=TURBID),
    Scene("plane", pose=(0.0, 10.0, 520.0, 20.0, 20.0, 0.0), texture="strong", water=Water(attenuation_per_m=0.1)),
    Scene("stones", pose=(10.0, 0.0, 540.0, 0.0, -15.0, 20.0), texture="slight"),
    Scene("frustum", pose=(-20.0, -10.0, 500.0, 5.0, 15.0, 60.0), texture="strong", water=TURBID, ambient=0.08),
)
"""Near and far, aside and turned, dull and blotched, in clear and turbid water."""


def test_normal_scans_are_quiet_and_the_second_scan_after_a_knock_is_not() -> None:
    instrument, trend = Instrument(draw_truth("modelled", 7, 400, 300, WATER.index)), HealthTrend()
    totals = []
    for scene in NORMAL:
        trend, judgement = judge_health(trend, instrument.scan(scene))
        assert not judgement.alarm
        totals += [] if judgement.point is None else [judgement.point.total]
    assert len(totals) >= 4, "of the one in turbid water nothing is said where backscatter may move the gaps"
    assert max(totals) < 4.0
    turned = with_mount_shifted(instrument.truth, MountShift("left", roll_deg=-0.02))
    knocked, _ = judge_health(trend, instrument.scan(Scene(object="shell"), turned))
    _, judgement = judge_health(knocked, instrument.scan(Scene(object="plane"), turned))
    assert judgement.alarm
    # In the words that the technician reads: the amplitude of a turn is that turn, within a twentieth.
    turned = with_mount_shifted(instrument.truth, MountShift("right", pitch_deg=0.03))
    after, judgement = judge_health(trend, instrument.scan(Scene(object="plane"), turned))
    assert judgement.alarm
    assert abs(after.points[-1].amplitudes_um[0]) == pytest.approx(math.radians(0.03) * 530_000.0, rel=0.05)
