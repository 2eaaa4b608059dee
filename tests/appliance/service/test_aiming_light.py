"""Water that hides and a torch on the object are told from live pictures, and an ordinary scene at rest is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.capture.aiming import WIDTH_PX, Aimed, Shade, look
from appliance.config import load_rig
from appliance.instrument import design_of, drawn_light_of
from appliance.scan.exposure import NOMINAL, Exposure
from appliance.scan.fault import FaultCode
from hw_sim.light.daylight import Daylight
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water, turbid

RIG = load_rig(Path("hw_sim/rigs/small.toml"))
SIZE = (RIG.camera.left.width_px, RIG.camera.left.height_px)
LIGHT, BLACK_DN = drawn_light_of(RIG), RIG.camera.left.black_level_dn
SHADE = LIGHT.shade(design_of(RIG).rig, Water().index, WIDTH_PX)
MILKY = Water(attenuation_per_m=3.0, backscatter=0.35)


def seen(scene: Scene, exposure: Exposure = NOMINAL, seed: int = 3) -> Aimed:
    """A live picture of the left camera, with both lasers on."""
    renderer = Renderer(draw_truth("realistic", seed, *SIZE, scene.water.index), scene)
    exposure_s = exposure.time_us / 1e6
    lit = [LightSlice(LIGHT.codes, exposure_s)]
    return look(renderer.expose("left", lit, 0.0, exposure_s, exposure.gain_db, (True, True), 1), BLACK_DN, SHADE)


def told(scene: Scene, exposure: Exposure = NOMINAL, seed: int = 3) -> FaultCode | None:
    fault = seen(scene, exposure, seed).fault(exposure.light / NOMINAL.light)
    return None if fault is None else fault.code


@pytest.mark.parametrize("name", ["pipe", "stones"])
def test_nearly_black_water_in_which_a_scan_is_poor_is_told_before_the_scan(name: str) -> None:
    """It said READY: some contrast was left."""
    assert told(Scene(object=name, water=MILKY)) is FaultCode.AIM_TURBID


@pytest.mark.parametrize("name", ["pipe", "ballbar"])
def test_a_torch_on_the_object_is_told_before_the_scan(name: str) -> None:
    """It said READY over a picture half of which was white."""
    assert told(Scene(object=name, daylight=Daylight(torch=3.0))) is FaultCode.AIM_LIGHT


@pytest.mark.parametrize(
    ("name", "water", "z_mm"),
    [("plane", turbid(0.4), 600.0), ("ballbar", turbid(2.0), 520.0), ("main", turbid(2.0), 500.0), ("shell", turbid(0.4), 545.0)],
)  # fmt: skip
def test_ordinary_scenes_at_rest_get_no_alarm(name: str, water: Water, z_mm: float) -> None:
    assert told(Scene(object=name, pose=(0.0, 0.0, z_mm, 0.0, 8.0, 0.0), water=water)) is None


def test_the_shade_is_where_the_projector_throws_no_light_at_any_distance() -> None:
    assert SHADE is not None
    assert SHADE.shape == (150, WIDTH_PX)
    shade = seen(Scene(object="plane", pose=(0.0, 0.0, 555.0, 0.0, 0.0, 0.0), ambient=0.0)).shade
    assert shade is not None
    assert shade.bright_dn < 20.0, "while the plane around it is white"
    assert LIGHT.shade(design_of(RIG).rig, Water().index, 20) is None, "too few pixels"


SMALL: NDArray[np.uint8] = np.zeros((1, 1), np.uint8)


@pytest.mark.parametrize(
    ("even", "bright", "glow", "saturated", "longer", "code"),
    [
        (2.0, 127.0, 250.0, 0.0, 1.0, None),
        (2.0, 128.0, 250.0, 0.0, 1.0, FaultCode.AIM_LIGHT),
        (2.0, 39.0, 250.0, 0.06, 1.0, None),
        (2.0, 41.0, 250.0, 0.06, 1.0, FaultCode.AIM_LIGHT),
        (2.0, 41.0, 250.0, 0.04, 1.0, None),
        (2.0, 79.0, 250.0, 0.06, 2.0, None),
        (2.0, 81.0, 250.0, 0.06, 2.0, FaultCode.AIM_LIGHT),
        (2.0, 41.0, 250.0, 0.06, 0.2, FaultCode.AIM_LIGHT),
        (2.0, 241.0, 250.0, 0.5, 30.0, FaultCode.AIM_LIGHT),
        (21.0, 30.0, 100.0, 0.0, 1.0, None),
        (23.0, 30.0, 100.0, 0.0, 1.0, FaultCode.AIM_TURBID),
        (23.0, 30.0, 100.0, 0.06, 1.0, None),
        (4.9, 6.0, 10.0, 0.0, 1.0, None),
    ],
)
def test_the_limits_of_light_in_the_shade(
    even: float, bright: float, glow: float, saturated: float, longer: float, code: FaultCode | None
) -> None:
    fault = Aimed(SMALL, 50.0, glow, Shade(even, bright), saturated).fault(longer)
    assert (None if fault is None else fault.code) is code
