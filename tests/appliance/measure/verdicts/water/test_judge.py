"""What a scan says about its water is what the water was, and nothing but water is taken for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.verdicts.water.backscatter import Cells
from appliance.measure.verdicts.water.beam import FAR_MM, GatheredLight, _beam, gather, half_field, shape_of_glow
from appliance.measure.verdicts.water.judge import WaterJudgement, halo_share, judge_water
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
from tests.support import synthetic
from tests.support.judged import as_judged
from tests.support.rendered import RenderedScan, render_scan
from tests.support.specks import add_specks
from tests.support.truth import WATER, true_calibration

WIDTH_PX = 320
TURBID = Water(attenuation_per_m=1.2, backscatter=0.15)


@dataclass(frozen=True)
class Judged:
    scan: RenderedScan
    said: WaterJudgement


def render(scene: Scene) -> RenderedScan:
    return render_scan(scene, "realistic", 5, WIDTH_PX, 16)


def judged(scan: RenderedScan) -> Judged:
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        images, cloud = as_judged(pipeline, scan.frames, 0.0, scan.exposure_s)
        return Judged(scan, judge_water(images, cloud, calibration.rig, WATER.index))


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


def test_flicker_is_no_veil(turbid: Judged) -> None:
    """Daylight that is brighter in the bright frame than in the dark one, by a third of the ambient light."""
    scan, frames = turbid.scan, {}
    for side, before in scan.frames.items():
        daylight = 20.0 * (1.0 + 0.25 * np.sin(2.1 * np.arange(len(before)) + 0.5))
        frames[side] = np.clip(np.rint(before + daylight[:, None, None]), 0, 255).astype(np.uint8)
    said = judged(replace(scan, frames=frames)).said
    assert abs(found(said.attenuation_per_m) - 1.2) < 3.0 * found(said.attenuation_sigma_per_m)
    assert found(said.veil_percent) == pytest.approx(found(turbid.said.veil_percent), abs=3.0)


def test_specks_that_pass_are_noticed_and_counted(without_scattering: RenderedScan) -> None:
    sequence, rng = without_scattering.sequence, np.random.default_rng(9)
    few, many = (
        judged(
            replace(without_scattering, frames={side: add_specks(f, sequence, n, rng) for side, f in without_scattering.frames.items()})
        ).said
        for n in (20, 300)
    )  # fmt: skip
    assert found(few.speck_percent) > 0.05
    assert few.judgement.fault is None
    assert found(many.speck_percent) > 4.0 * found(few.speck_percent)
    fault = many.judgement.fault
    assert fault is not None
    assert (fault.code, many.judgement.verdict.passed) == (FaultCode.WATER_DIRTY, False)
    assert fault.numbers["coverage_percent"] == pytest.approx(100.0 - found(many.masked_percent))


def test_nothing_before_the_instrument_is_no_judgement(without_scattering: RenderedScan) -> None:
    dark = {side: np.full_like(frames, 2) for side, frames in without_scattering.frames.items()}
    said = judged(replace(without_scattering, frames=dark)).said
    assert (said.judgement.verdict.passed, said.veil_percent, said.masked_percent) == (None, None, None)


def test_bright_light_without_an_object_is_no_object(without_scattering: RenderedScan) -> None:
    """Photons alone change each pixel by as much as faint stripes; a sixth of lit water under a flood light was an object."""
    rng = np.random.default_rng(8)
    shot = {side: rng.normal(220.0, 2.1, frames.shape) for side, frames in without_scattering.frames.items()}
    frames = {side: np.clip(np.rint(one), 0, 255).astype(np.uint8) for side, one in shot.items()}
    said = judged(replace(without_scattering, frames=frames)).said
    assert found(said.object_percent) < 0.1


COUNT = 120
RNG = np.random.default_rng(10_001)
PLACE, ONE = np.linspace(0.0, 1.0, COUNT), np.ones(COUNT)
GATHERED = GatheredLight((0.5 + 2.0 * PLACE)[:, None], 0.8 * ONE[:, None], 300.0 * ONE, ONE, ONE)
SIGNAL_DN = 80.0 + 40.0 * np.sin(7.0 * PLACE)


def cells(veil_dn: float, halo: float) -> Cells:
    seen = veil_dn * (0.5 + 2.0 * PLACE) + halo * SIGNAL_DN + RNG.normal(0.0, 0.05, COUNT)
    return Cells(np.arange(COUNT), 100.0 * ONE, np.zeros((COUNT, 2)), seen, 0.05 * ONE, SIGNAL_DN, 2.0 * ONE)


def test_scattering_by_small_angles_is_told_from_backscatter() -> None:
    """A third of the light of a complete scan was called backscatter at 1 /m, where it was 2 %."""
    made = cells(2.0, 0.4)
    true = 0.4 * SIGNAL_DN.sum() / (made.signal_dn + made.backscatter_dn).sum()
    assert halo_share(made, GATHERED) == pytest.approx(true, rel=0.05)


def test_a_trace_of_halo_or_an_object_that_sends_nothing_back_leaves_the_backscatter_as_it_is_measured() -> None:
    """The equations of the second one have no solution, for any attenuation."""
    assert halo_share(cells(5.0, 0.02), GATHERED) == 0.0
    assert halo_share(replace(cells(5.0, 0.0), signal_dn=np.zeros(COUNT)), GATHERED) == 0.0


CELLS = (16, 12)
RIG, INDEX = synthetic.calibration().rig, synthetic.WATER.index


def gathered(ends_at_mm: float | None) -> GatheredLight:
    """What the rays of the cells gather on their way to that depth; ``None``: all that there is."""
    row, column = np.divmod(np.arange(CELLS[0] * CELLS[1]), CELLS[0])
    place = (np.stack([column, row], -1) + 0.5) / CELLS
    origins, directions = RIG.left.rays(place * (RIG.left.width_px, RIG.left.height_px) - 0.5, INDEX)
    ends = np.full(len(origins), FAR_MM) if ends_at_mm is None else (ends_at_mm - origins[:, 2]) / directions[:, 2]
    return gather(_beam(RIG, INDEX), origins, directions, ends)


def glow(per_m: float, mean_dn: float = 20.0) -> NDArray[np.float64]:
    light = gathered(None).backscatter(per_m)
    return np.asarray(mean_dn * light / light.mean())


def surface(per_m: float, mean_dn: float, depth_mm: float) -> NDArray[np.float64]:
    at = gathered(depth_mm)
    light = at.falls * np.exp(-per_m * at.ends_m)
    return np.asarray(mean_dn * light / light.mean())


def test_the_beam_is_as_wide_and_as_high_as_what_the_left_camera_sees() -> None:
    camera = RIG.left
    u, v = (camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0
    _, way = camera.rays(np.array([[u, v], [0.0, v], [u, 0.0]]), INDEX)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    assert half_field(camera, INDEX) == pytest.approx(np.tan(np.arccos(way[1:] @ way[0])), rel=0.01)


@pytest.mark.parametrize("per_m", [0.5, 1.5, 2.5, 4.0])
def test_the_glow_of_water_alone_says_how_it_fades(per_m: float) -> None:
    assert shape_of_glow(glow(per_m), CELLS, RIG, INDEX) == pytest.approx(per_m)


def test_a_blurred_object_behind_the_glow_does_not_make_the_water_clearer() -> None:
    """A plane in water of 6 per m: a sixth of the light is the plane's, without a fringe; the glow was read as 1.5 per m, that of
    water with nothing before the instrument."""
    seen = glow(2.5, 19.0) + surface(2.5, 3.0, 480.0)
    assert shape_of_glow(seen, CELLS, RIG, INDEX) == pytest.approx(2.5, abs=0.5)


def test_where_a_surface_would_make_most_of_the_light_the_glow_is_asked_alone() -> None:
    """Its own shape would be read as attenuation otherwise: an object that is too far away, in water like milk."""
    found = shape_of_glow(surface(6.0, 20.0, 700.0) + glow(1.0, 1.0), CELLS, RIG, INDEX)
    assert found is not None
    assert found < 1.0


def test_too_little_light_has_no_shape() -> None:
    assert shape_of_glow(glow(2.0, 0.2), CELLS, RIG, INDEX) is None
    few = glow(2.0)
    few[59:] = np.nan
    assert shape_of_glow(few, CELLS, RIG, INDEX) is None
