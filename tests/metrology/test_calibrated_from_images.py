"""From images to a calibration to images: a rig that nobody knows measures artefacts it was not calibrated with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording
from appliance.calibration.water.calibrate import calibrate
from appliance.calibration.water.extract import CALIBRATING_GAP_MM, BarCertificate, extract
from appliance.calibration.water.method import Method
from appliance.evaluation.result import LENGTHS, Artefact, Result, evaluate
from appliance.offline.evaluation import JUDGING_GAP_MM
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.reconstruct.quality import QualityLimits
from hw_sim.objects.shapes import BALL_RADIUS_MM, FRUSTUM_BASE_MM, FRUSTUM_HEIGHT_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from tests.support.calibrating import CALIBRATION_BARS, CALIBRATION_PLANES, Pose, air_of, start_of
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER

SEED = 2
EXPOSURE_S = 0.008
"""As the instrument would choose it: nothing clipped, also on the nearest ball."""
KINDS = {Artefact.BALL_BAR: "ballbar", Artefact.PLANE: "plane", Artefact.FRUSTUM: "frustum"}
UNSEEN = (
    (Artefact.BALL_BAR, Pose((5.0, 10.0, 530.0), (0.0, 20.0, -30.0))),
    (Artefact.BALL_BAR, Pose((0.0, 0.0, 505.0), (0.0, -15.0, 50.0))),
    (Artefact.BALL_BAR, Pose((-5.0, 5.0, 545.0), (0.0, 30.0, 85.0))),
    (Artefact.PLANE, Pose((0.0, 0.0, 525.0), (12.0, -15.0, 0.0))),
    (Artefact.PLANE, Pose((0.0, 0.0, 490.0), (-15.0, 5.0, 0.0))),
    (Artefact.FRUSTUM, Pose((0.0, 0.0, 550.0), (5.0, -8.0, 12.0))),
)


def scan_of(artefact: Artefact, pose: Pose) -> RenderedScan:
    scene = Scene(object=KINDS[artefact], pose=(*pose.at_mm, *pose.turns_deg))
    return render_scan(scene, "realistic", SEED, 1600, 16, EXPOSURE_S)


def reconstructed(scan: RenderedScan, calibration: Calibration, max_gap_mm: float) -> tuple[Pipeline, Cloud]:
    with Pipeline(calibration, WATER, scan.sequence, QualityLimits(max_gap_mm=max_gap_mm)) as pipeline:
        for k in range(len(scan.sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, k)
        pipeline.coarse()
        return pipeline, pipeline.full()


def recording_of(artefact: Artefact, pose: Pose, start: Calibration, name: str) -> Recording:
    pipeline, cloud = reconstructed(scan_of(artefact, pose), start, CALIBRATING_GAP_MM)
    certificate = BarCertificate(150.0, radius_mm=BALL_RADIUS_MM) if artefact is Artefact.BALL_BAR else None
    found = extract(name, certificate, cloud, pipeline.decoded("left"), pipeline.decoded("right"), start, WATER)
    assert isinstance(found, Recording), found
    return found


def measured(scan: RenderedScan, calibration: Calibration, artefact: Artefact, truth: TrueRig) -> Result:
    slanted = float(np.sqrt(0.5 * (FRUSTUM_BASE_MM - FRUSTUM_TOP_MM) ** 2 + FRUSTUM_HEIGHT_MM**2))
    lengths = {
        "length": truth.artefacts.ball_distance_mm,
        "top": FRUSTUM_TOP_MM,
        "base": FRUSTUM_BASE_MM,
        "slanted": slanted,
        "height": FRUSTUM_HEIGHT_MM,
    }
    _, cloud = reconstructed(scan, calibration, JUDGING_GAP_MM)
    return evaluate(cloud, artefact, {name: lengths[name] for name in LENGTHS[artefact]})


@dataclass
class Worst:
    """Largest errors, percent."""

    bar: float = 0.0
    frustum: float = 0.0
    flat: float = 0.0
    noise_mm: float = 0.0

    def add(self, result: Result) -> None:
        if result.artefact is Artefact.BALL_BAR:
            self.bar = max(self.bar, 100.0 * (result.worst_e_l or np.inf))
        elif result.artefact is Artefact.FRUSTUM:
            self.frustum = max(self.frustum, 100.0 * (result.worst_e_l or np.inf))
        else:
            self.flat = max(self.flat, 100.0 * (result.e_f_sys or np.inf))
            self.noise_mm = max(self.noise_mm, result.noise_mm or np.inf)


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_two_bars_and_two_planes_scanned_by_a_hidden_rig_calibrate_it() -> None:
    first = scan_of(Artefact.BALL_BAR, CALIBRATION_BARS[0])
    truth = first.renderer.truth
    start = start_of(air_of(truth))
    recordings = [recording_of(Artefact.BALL_BAR, p, start, f"bar {k}") for k, p in enumerate(CALIBRATION_BARS)]
    recordings += [recording_of(Artefact.PLANE, p, start, f"plane {k}") for k, p in enumerate(CALIBRATION_PLANES)]
    climbed = {m: calibrate(m, recordings, start) for m in Method}
    measured_with = {"air": start, **climbed[Method.PAPER].before}
    measured_with |= {m.value: r.calibration for m, r in climbed.items()}
    worst: dict[str, Worst] = {}
    for artefact, pose in UNSEEN:
        scan = scan_of(artefact, pose)
        for name, calibration in measured_with.items():
            result = measured(scan, calibration, artefact, truth)
            worst.setdefault(name, Worst()).add(result)
    for name, w in worst.items():
        print(
            f"{name:<10} E_Lb {w.bar:.3f} %  E_Lp {w.frustum:.3f} %  E_F,sys {w.flat:.3f} %  noise {w.noise_mm:.3f} mm"
        )
    for method, made in climbed.items():
        print(method.value, f"{made.calibration.residual_px:.4f} px", made.warnings)
    spline = worst[Method.SPLINE.value]
    assert worst["air"].bar > 0.1, "a rig that needs no calibration proves nothing"
    assert spline.bar < 0.04
    assert spline.frustum < 0.1
    assert spline.flat < 0.04
    assert worst[Method.PORTS.value].bar < 0.5 * worst["air"].bar
    assert climbed[Method.SPLINE].calibration.residual_px == pytest.approx(0.03, abs=0.015)
