"""From images: whatever is scanned, in whatever water, no alarm; a knocked camera or salt taken for fresh, an alarm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from appliance.calibration.health import HealthJudgement, HealthTrend, judge
from appliance.calibration.patches import PatchGaps
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.sides import SIDES
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth
from hw_sim.water.medium import Water
from tests.support.rendered import EXPOSURE_S, pictures
from tests.support.truth import WATER, true_calibration

SEQUENCE = build_sequence(16)
PICTURES = pictures(SEQUENCE)
OBJECTS = ("pipe", "shell", "plane", "stones", "frustum", "ballbar")
WATERS = (Water(), Water(attenuation_per_m=1.2, backscatter=0.08, blur_px_per_m=1.0), Water(attenuation_per_m=0.1))


def scenes(seed: int) -> Iterator[Scene]:
    """What a diver may put before the instrument: near and far, aside and turned, dull and blotched, clear and turbid."""
    rng = np.random.default_rng(seed)
    for number in range(1000):
        name = OBJECTS[number % len(OBJECTS)]
        pose = (
            *(float(v) for v in rng.uniform((-40.0, -30.0, 470.0), (40.0, 30.0, 570.0))),
            *(float(v) for v in rng.uniform((-20.0, -20.0, -60.0), (20.0, 20.0, 60.0))),
        )
        again = number // len(OBJECTS)
        texture = ("slight", "none", "strong")[(again + number // 2) % 3]
        yield Scene(
            object=name,
            pose=pose,  # type: ignore[arg-type]
            texture=texture,
            water=WATERS[(again + number) % len(WATERS)],
            ambient=float(rng.uniform(0.0, 0.08)),
        )


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
            self._shots += 100
            frames = np.stack(
                [
                    renderer.expose(
                        side, [LightSlice(p, EXPOSURE_S)], 0.0, EXPOSURE_S, 0.0, (False, False), self._shots + k
                    )
                    for k, p in enumerate(PICTURES)
                ]
            )
            for k in range(len(SEQUENCE)):
                self._pipeline.push(side, frames, k)
        self._pipeline.find_coarse()
        gaps = self._pipeline.find_full().gaps
        assert gaps is not None
        return gaps


def normal(count: int) -> tuple[Instrument, HealthTrend, list[HealthJudgement]]:
    instrument = Instrument(draw_truth("modelled", 7, 400, 300, WATER.index))
    trend, said = HealthTrend(), []
    for scene in islice(scenes(3), count):
        trend, judgement = judge(trend, instrument.scan(scene))
        said.append(judgement)
    return instrument, trend, said


def assert_quiet(said: list[HealthJudgement], judged: int) -> None:
    points = [judgement.point for judgement in said if judgement.point is not None]
    assert len(points) >= judged, "most scans see enough of the image"
    assert not any(judgement.alarm for judgement in said)
    assert max(point.total for point in points) < 4.0, [(round(p.score, 1), round(p.total, 1)) for p in points]


def test_normal_scans_and_then_a_knock() -> None:
    """One of the eight is of a ball bar, which shows too little of the image to be judged. The knock is found by the second scan."""
    instrument, trend, said = normal(8)
    assert_quiet(said, judged=7)
    turned = with_mount_shifted(instrument.truth, MountShift("left", roll_deg=-0.02))
    trend, _ = judge(trend, instrument.scan(Scene(object="shell"), turned))
    _, judgement = judge(trend, instrument.scan(Scene(object="plane"), turned))
    assert judgement.alarm


def test_the_amplitude_of_a_turn_is_that_turn() -> None:
    """From images, in the words that the technician reads: within a twentieth of what was done."""
    instrument, trend, _ = normal(1)
    turned = with_mount_shifted(instrument.truth, MountShift("right", pitch_deg=0.03))
    after, judgement = judge(trend, instrument.scan(Scene(object="plane"), turned))
    assert judgement.alarm
    height_um = after.points[-1].amplitudes_um[0]
    assert abs(height_um) == pytest.approx(math.radians(0.03) * 530_000.0, rel=0.05)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_larger_images() -> None:
    """A turn of 0.02° about each axis, and fresh water's index in the sea, at the first or second scan."""
    truth = draw_truth("modelled", 7, 800, 600, WATER.index)
    instrument, trend, said = Instrument(truth), HealthTrend(), []
    pair = (Scene(object="plane"), Scene(object="shell"))
    for scene in pair * 2:
        trend, judgement = judge(trend, instrument.scan(scene))
        said.append(judgement)
    assert_quiet(said, judged=4)
    turns = [MountShift("right", pitch_deg=0.02), MountShift("right", yaw_deg=0.02), MountShift("left", roll_deg=0.02)]
    changed = [
        *(with_mount_shifted(truth, turn) for turn in turns),
        replace(truth, n_water=Water(salinity_psu=35.0).index),
    ]
    for other in changed:
        after, alarms = trend, []
        for scene in pair:
            after, judgement = judge(after, instrument.scan(scene, other))
            alarms.append(judgement.alarm)
            if alarms[-1]:
                break
        assert any(alarms), [point.score for point in after.points[-2:]]
