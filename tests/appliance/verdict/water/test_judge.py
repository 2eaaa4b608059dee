"""What a scan says about its water is what the water was, and nothing but water is taken for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.machine.alerts import headline_of
from appliance.patterns.sequence import Direction
from appliance.reconstruct.images import ScanImages
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.fault import FaultCode
from appliance.verdict.water.judge import WaterJudgement, judge_water
from hw_sim.scene import Imaging, Scene
from hw_sim.water.medium import Water
from tests.support.rendered import RenderedScan, render_scan
from tests.support.specks import add_specks
from tests.support.truth import WATER, true_calibration

WIDTH_PX = 400
TURBID = Water(attenuation_per_m=1.2, backscatter=0.15)


@dataclass(frozen=True)
class Judged:
    scan: RenderedScan
    said: WaterJudgement


def render(scene: Scene, exposure_s: float = 0.012, period_px: int = 16) -> RenderedScan:
    return render_scan(scene, "realistic", 5, WIDTH_PX, period_px, exposure_s)


def judged(scan: RenderedScan) -> Judged:
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        for side, frames in scan.frames.items():
            for k in range(len(scan.sequence)):
                pipeline.push(side, frames, k)
        cloud = pipeline.coarse()
        decoded = {side: pipeline.decoded(side) for side in scan.frames}
        recorded = ScanImages(scan.sequence, scan.frames, decoded)
        return Judged(scan, judge_water(recorded, cloud, calibration.rig, WATER.index))


@pytest.fixture(scope="module")
def turbid() -> Judged:
    return judged(render(Scene(object="shell", water=TURBID)))


@pytest.fixture(scope="module")
def without_scattering() -> RenderedScan:
    """The same water, as if it sent nothing back."""
    return render(Scene(object="shell", water=replace(TURBID, backscatter=0.0)))


def found(value: float | None) -> float:
    assert value is not None
    return value


def test_the_veil_is_what_the_scattering_added(turbid: Judged, without_scattering: RenderedScan) -> None:
    bright, dark = (turbid.scan.frames["left"][k].astype(float) for k in (0, 1))
    clear = without_scattering.frames["left"][0].astype(float)
    seen = turbid.scan.renderer.view("left", 0.0).seen_by_all & (bright < 255)
    true_percent = 100.0 * (bright - clear)[seen].sum() / (bright - dark)[seen].sum()
    assert true_percent > 10.0
    assert found(turbid.said.veil_percent) == pytest.approx(true_percent, abs=1.0)


def test_attenuation_is_the_waters(turbid: Judged) -> None:
    sigma = found(turbid.said.attenuation_sigma_per_m)
    assert sigma < 0.2
    assert abs(found(turbid.said.attenuation_per_m) - TURBID.attenuation_per_m) < 3.0 * sigma
    assert found(turbid.said.backscatter_percent) == pytest.approx(15.0, rel=0.4)


def test_no_scattering_is_no_veil_and_says_nothing_of_attenuation(without_scattering: RenderedScan) -> None:
    said = judged(without_scattering).said
    assert found(said.veil_percent) < 0.5
    assert said.attenuation_per_m is None or found(said.attenuation_sigma_per_m) > 0.5
    assert said.judgement.verdict.passed


@pytest.mark.parametrize("imaging", [Imaging(response="gamma"), Imaging(projector_defocus=False)])
def test_soft_fringes_and_a_bent_response_are_no_veil(turbid: Judged, imaging: Imaging) -> None:
    said = judged(render(Scene(object="shell", water=TURBID, imaging=imaging, ambient=0.1), exposure_s=0.011)).said
    assert found(said.veil_percent) == pytest.approx(found(turbid.said.veil_percent), abs=1.0)
    assert abs(found(said.attenuation_per_m) - 1.2) < 3.0 * found(said.attenuation_sigma_per_m)


def test_flicker_is_no_veil(turbid: Judged) -> None:
    """Daylight that is brighter in the bright frame than in the dark one, by a third of the ambient light."""
    rng = np.random.default_rng(3)
    scan = render(Scene(object="shell", water=TURBID, ambient=0.1))
    frames = {}
    for side, before in scan.frames.items():
        ambient = np.maximum(before[scan.sequence.dark].astype(np.float32) - 2.0, 0.0)
        share = 0.25 * np.sin(2.1 * np.arange(len(before)) + 0.5)
        light = before + share[:, None, None] * ambient + rng.random(before.shape) - 0.5
        frames[side] = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    said = judged(replace(scan, frames=frames)).said
    assert abs(found(said.attenuation_per_m) - 1.2) < 3.0 * found(said.attenuation_sigma_per_m)
    assert found(said.veil_percent) == pytest.approx(found(turbid.said.veil_percent), abs=3.0)


def test_a_dark_object_in_clear_water_is_not_dirty_water(without_scattering: RenderedScan) -> None:
    """A tenth of the light: most of it is too weak to be decoded, and the water is not to blame."""
    dim = {
        side: np.rint(2.0 + 0.07 * (frames.astype(np.float32) - 2.0)).astype(np.uint8)
        for side, frames in without_scattering.frames.items()
    }
    said = judged(replace(without_scattering, frames=dim)).said
    assert said.judgement.fault is None


def test_water_that_hides_the_object_is_called_dirty_with_what_is_left() -> None:
    said = judged(render(Scene(object="shell", water=Water(attenuation_per_m=3.4, backscatter=0.5)), 0.0165)).said
    fault = said.judgement.fault
    assert fault is not None
    assert fault.code is FaultCode.WATER_DIRTY
    assert headline_of(fault) == "WATER DIRTY"
    assert fault.numbers["coverage_percent"] == pytest.approx(100.0 - found(said.masked_percent))
    assert not said.judgement.verdict.passed


def test_a_veil_as_bright_as_a_third_of_the_light_is_told_although_most_points_are_there() -> None:
    milky = Scene(object="plane", texture="none", water=Water(attenuation_per_m=2.0, backscatter=0.3))
    said = judged(render(milky, 0.0165)).said
    assert found(said.veil_percent) > 30.0
    fault = said.judgement.fault
    assert fault is not None
    assert fault.code is FaultCode.WATER_DIRTY


def test_specks_that_pass_are_noticed_and_counted(without_scattering: RenderedScan) -> None:
    sequence, rng = without_scattering.sequence, np.random.default_rng(9)
    few, many = (
        judged(
            replace(
                without_scattering,
                frames={side: add_specks(f, sequence, n, rng) for side, f in without_scattering.frames.items()},
            )
        ).said
        for n in (20, 300)
    )
    assert found(few.speck_percent) > 0.05
    assert few.judgement.fault is None
    assert found(many.speck_percent) > 4.0 * found(few.speck_percent)
    assert many.judgement.fault is not None
    assert many.judgement.fault.code is FaultCode.WATER_DIRTY


def test_nothing_before_the_instrument_is_no_judgement(without_scattering: RenderedScan) -> None:
    dark = {side: np.full_like(frames, 2) for side, frames in without_scattering.frames.items()}
    said = judged(replace(without_scattering, frames=dark)).said
    assert said.judgement.verdict.passed is None
    assert said.veil_percent is None
    assert said.masked_percent is None


def test_bright_light_without_an_object_is_no_object(without_scattering: RenderedScan) -> None:
    """Photons alone change each pixel by as much as faint stripes; a sixth of lit water under a flood light was an object."""
    rng = np.random.default_rng(8)
    shot = {side: rng.normal(220.0, 2.1, frames.shape) for side, frames in without_scattering.frames.items()}
    frames = {side: np.clip(np.rint(one), 0, 255).astype(np.uint8) for side, one in shot.items()}
    said = judged(replace(without_scattering, frames=frames)).said
    assert found(said.object_percent) < 0.1


def test_long_fringes_tell_the_same(turbid: Judged) -> None:
    said = judged(render(Scene(object="shell", water=TURBID), period_px=64)).said
    assert found(said.veil_percent) == pytest.approx(found(turbid.said.veil_percent), abs=1.5)
    assert len(turbid.scan.sequence.axis(Direction.X).gray) == 7
