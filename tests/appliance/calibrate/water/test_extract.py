"""A scanned artefact becomes a recording of true correspondences; what would bend a calibration is left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.base import silent
from appliance.calibrate.recordings import Recording
from appliance.calibrate.stored_recordings import recording_of_scan
from appliance.calibrate.water.extract import BarCertificate
from appliance.cli.simrig import default_sim_rig
from appliance.measure.accept.points import NotFound
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import StereoRig
from appliance.measure.light.port import Port
from appliance.measure.light.water import Water
from appliance.store.config import load_rig
from hw_sim.objects.shapes import BALL_RADIUS_MM
from hw_sim.scene import Scene
from hw_sim.truth import project, ray
from hw_sim.water.medium import GREEN_NM
from tests.support.rendered import RenderedScan, render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

WIDTH_PX = 480
BAR = BarCertificate(150.0, radius_mm=BALL_RADIUS_MM)
DRAWN = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
PLANE = Scene(object="plane", texture="strong")


@dataclass(frozen=True)
class Case:
    scan: RenderedScan
    folder: Path
    start: Calibration
    """Ports as drawn: the hidden rig's are others."""

    def extracted(self, certificate: BarCertificate | None) -> Recording | NotFound:
        return recording_of_scan(self.folder, certificate, self.start, load_rig(default_sim_rig()), silent)

    def recording(self, certificate: BarCertificate | None) -> Recording:
        found = self.extracted(certificate)
        assert isinstance(found, Recording), found
        return found

    def miss_px(self, recording: Recording) -> NDArray[np.float64]:
        """Matched right pixels against where the truth's right camera sees what the left pixel sees."""
        truth, surface = self.scan.renderer.truth, self.scan.renderer.surface(0.0)
        origin, direction = ray(truth, "left", recording.left_px)
        s = np.full(len(origin), 350.0)
        for _ in range(80):
            s += surface.distance_mm(origin + s[:, None] * direction)
        points = origin + s[:, None] * direction
        assert np.abs(surface.distance_mm(points)).max() < 1e-6
        return np.asarray(recording.right_px - project(truth, "right", points))


def case_of(scene: Scene, folder: Path, exposure_s: float = 0.012) -> Case:
    scan = render_scan(scene, "realistic", 4, WIDTH_PX, 16, exposure_s)
    start = true_calibration(scan.renderer.truth)
    drawn = StereoRig(replace(start.rig.left, port=DRAWN), replace(start.rig.right, port=DRAWN))
    return Case(scan, store(scan, folder / "000012"), replace(start, rig=drawn))


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return case_of(PLANE, tmp_path_factory.mktemp("plane"))


@pytest.fixture(scope="module")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return case_of(Scene(object="ballbar"), tmp_path_factory.mktemp("bar"))


def test_matches_are_true_to_hundredths_of_a_pixel_without_bias(plane: Case, bar: Case) -> None:
    # All over the artefact: of the plane in the image, of the first ball more than half of its width.
    for case, certificate, wide_px in (
        (plane, None, 0.75 * WIDTH_PX),
        (bar, BAR, BALL_RADIUS_MM / 0.32 * WIDTH_PX / 800),
    ):
        recording = case.recording(certificate)
        miss = case.miss_px(recording)
        assert len(miss) > 200
        assert np.abs(miss.mean(axis=0)).max() < 0.006
        assert miss.std(axis=0).max() < 0.04
        assert np.abs(miss).max() < 0.3
        assert np.ptp(recording.left_px[recording.sphere == 0, 0]) > wide_px
        if certificate is None:
            # Of windows on the borders of dark patches few remain: where fringes are blurred, their phase would be shifted.
            bright = case.scan.frames["left"][case.scan.sequence.bright].astype(float)
            u, v = recording.left_px.astype(int).T
            steep = np.maximum(*(np.abs(np.gradient(bright, 4, axis=a)) / np.maximum(bright, 20.0) for a in (1, 0)))
            assert np.percentile(steep[v, u], 99) < 0.7 * np.percentile(steep[100:-100, 100:-100], 99)
        else:
            scene = case.scan.renderer.scene.water
            assert recording.water == Water(scene.temperature_c, scene.salinity_psu, GREEN_NM), "the scan's own"
            assert (recording.name, recording.radius_mm) == ("000012", BALL_RADIUS_MM)


def test_nothing_saturated_is_near_a_used_pixel(tmp_path: Path) -> None:
    """Three times the light: a part of the plane is clipped, and what is beside it must not be used either."""
    case = case_of(PLANE, tmp_path, exposure_s=0.036)
    recording = case.recording(None)
    sines = np.array([p.kind.name == "SINE" for p in case.scan.sequence.patterns])
    for side, px in (("left", recording.left_px), ("right", np.rint(recording.right_px))):
        clipped = (case.scan.frames[side][sines] == 255).any(axis=0)
        assert 0.05 < clipped.mean() < 0.95
        u, v = px.astype(int).T
        assert not any(clipped[v + dv, u + du].any() for dv in (-3, 0, 3) for du in (-3, 0, 3))
    assert np.abs(case.miss_px(recording).mean(axis=0)).max() < 0.01


def test_an_unstated_radius_is_estimated_and_what_is_not_there_said_in_words(plane: Case, bar: Case) -> None:
    found = bar.recording(BarCertificate(150.0))
    assert found.radius_mm == pytest.approx(BALL_RADIUS_MM, abs=0.2)
    assert found.radius_mm != BALL_RADIUS_MM
    assert found.radius_sd_mm >= 0.1
    for case, certificate in ((plane, BAR), (bar, None)):
        nothing = case.extracted(certificate)
        assert isinstance(nothing, NotFound)
        assert ";" in nothing.reason, "what to do is part of the reason"
