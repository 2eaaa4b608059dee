"""A scanned artefact becomes a recording of true correspondences; what would bend a calibration is left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording
from appliance.calibration.water.extract import CALIBRATING_GAP_MM, BarCertificate, extract
from appliance.cli.simrig import default_sim_rig
from appliance.config import load_rig
from appliance.evaluation.points import NotFound
from appliance.offline.calibration.recordings import recording_of_scan
from appliance.optics.model import StereoRig
from appliance.optics.port import Port
from appliance.optics.water import Water
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.quality import QualityLimits
from hw_sim.objects.shapes import BALL_RADIUS_MM
from hw_sim.scene import Scene
from hw_sim.truth import project, ray
from hw_sim.water.medium import GREEN_NM
from tests.support.rendered import RenderedScan, render_scan
from tests.support.stored import store
from tests.support.truth import WATER, true_calibration

WIDTH_PX = 640
BAR = BarCertificate(150.0, radius_mm=BALL_RADIUS_MM)


@dataclass(frozen=True)
class Case:
    scan: RenderedScan
    start: Calibration
    """Ports as drawn: the hidden rig's are others."""
    recording: Recording


def case_of(scene: Scene, certificate: BarCertificate | None, exposure_s: float = 0.012) -> Case:
    scan = render_scan(scene, "realistic", 4, WIDTH_PX, 16, exposure_s)
    start = with_drawn_ports(true_calibration(scan.renderer.truth))
    recording = extracted(scan, start, certificate)
    assert isinstance(recording, Recording), recording
    return Case(scan, start, recording)


def with_drawn_ports(calibration: Calibration) -> Calibration:
    drawn = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
    rig = calibration.rig
    return replace(calibration, rig=StereoRig(replace(rig.left, port=drawn), replace(rig.right, port=drawn)))


def extracted(scan: RenderedScan, start: Calibration, certificate: BarCertificate | None) -> Recording | NotFound:
    with Pipeline(start, WATER, scan.sequence, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM)) as pipeline:
        for k in range(len(scan.sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, k)
        pipeline.coarse()
        cloud = pipeline.full()
    return extract("scan", certificate, cloud, pipeline.decoded("left"), pipeline.decoded("right"), start, WATER)


@pytest.fixture(scope="module")
def plane() -> Case:
    return case_of(Scene(object="plane", texture="strong"), None)


@pytest.fixture(scope="module")
def bar() -> Case:
    return case_of(Scene(object="ballbar"), BAR)


def miss_px(case: Case) -> NDArray[np.float64]:
    """Matched right pixels against where the truth's right camera sees what the left pixel sees."""
    origin, direction = ray(case.scan.renderer.truth, "left", case.recording.left_px)
    surface = case.scan.renderer.surface(0.0)
    s = np.full(len(origin), 350.0)
    for _ in range(80):
        s += surface.distance_mm(origin + s[:, None] * direction)
    points = origin + s[:, None] * direction
    assert np.abs(surface.distance_mm(points)).max() < 1e-6
    return np.asarray(case.recording.right_px - project(case.scan.renderer.truth, "right", points))


@pytest.mark.parametrize("name", ["plane", "bar"])
def test_matches_are_true_to_hundredths_of_a_pixel_without_bias(name: str, request: pytest.FixtureRequest) -> None:
    case: Case = request.getfixturevalue(name)
    miss = miss_px(case)
    assert len(miss) > 400
    assert np.abs(miss.mean(axis=0)).max() < 0.006
    assert miss.std(axis=0).max() < 0.04
    assert np.abs(miss).max() < 0.3
    # All over the artefact: of the plane in the image, of the first ball more than half of its width.
    seen = case.recording.left_px[case.recording.sphere == 0, 0]
    assert np.ptp(seen) > (0.75 * WIDTH_PX if name == "plane" else BALL_RADIUS_MM / 0.32 * WIDTH_PX / 800)
    if name == "plane":
        # Of windows on the borders of dark patches few remain: where fringes are blurred, their phase would be shifted.
        bright = case.scan.frames["left"][case.scan.sequence.bright].astype(float)
        u, v = case.recording.left_px.astype(int).T
        slopes = [np.abs(np.gradient(bright, 4, axis=a)) / np.maximum(bright, 20.0) for a in (1, 0)]
        steep = np.maximum(*slopes)
        assert np.percentile(steep[v, u], 99) < 0.7 * np.percentile(steep[100:-100, 100:-100], 99)


def test_nothing_saturated_is_near_a_used_pixel() -> None:
    """Three times the light: a part of the plane is clipped, and what is beside it must not be used either."""
    case = case_of(Scene(object="plane", texture="strong"), None, exposure_s=0.036)
    for side, px in (("left", case.recording.left_px), ("right", np.rint(case.recording.right_px))):
        sines = np.array([p.kind.name == "SINE" for p in case.scan.sequence.patterns])
        clipped = (case.scan.frames[side][sines] == 255).any(axis=0)
        assert 0.05 < clipped.mean() < 0.95
        u, v = px.astype(int).T
        assert not any(clipped[v + dv, u + du].any() for dv in (-3, 0, 3) for du in (-3, 0, 3))
    assert np.abs(miss_px(case).mean(axis=0)).max() < 0.01


def test_an_unstated_radius_is_estimated_and_not_believed(bar: Case) -> None:
    found = extracted(bar.scan, bar.start, BarCertificate(150.0))
    assert isinstance(found, Recording)
    assert found.radius_mm == pytest.approx(BALL_RADIUS_MM, abs=0.2)
    assert found.radius_mm != BALL_RADIUS_MM
    assert found.radius_sd_mm >= 0.1
    assert bar.recording.radius_mm == BALL_RADIUS_MM


def test_what_is_not_there_is_said_in_words(plane: Case, bar: Case) -> None:
    for case, certificate in ((plane, BAR), (bar, None)):
        found = extracted(case.scan, case.start, certificate)
        assert isinstance(found, NotFound)
        assert ";" in found.reason, "what to do is part of the reason"


def test_a_stored_scan_gives_the_same_recording_and_its_own_water(tmp_path: Path, bar: Case) -> None:
    folder = store(bar.scan, tmp_path / "000012")
    seen: list[str] = []
    found = recording_of_scan(folder, BAR, bar.start, load_rig(default_sim_rig()), seen.append)
    assert isinstance(found, Recording)
    assert found.name == "000012"
    scene = bar.scan.renderer.scene.water
    assert found.water == Water(scene.temperature_c, scene.salinity_psu, GREEN_NM)
    np.testing.assert_array_equal(found.right_px, bar.recording.right_px)
    assert "looking for the artefact" in seen
