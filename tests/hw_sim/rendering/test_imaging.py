"""Each cause of an impure sine can be switched off, and is what it says while it is on."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.objects.texture import CHECKER, albedo, noise_lattice
from hw_sim.options import OptionError, WorldOptions
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import draw_truth

EXPOSURE_S = 0.012
AT_FOCUS, FAR = 522.5, 612.5


def picture(
    codes: np.ndarray,
    imaging: Imaging,
    z_mm: float = AT_FOCUS,
    texture: str = "none",
    size: tuple[int, int] = (400, 300),
) -> np.ndarray:
    scene = Scene(
        object="plane", pose=(0.0, 0.0, z_mm, 0.0, 0.0, 0.0), texture=texture, noise=False, ambient=0.0, imaging=imaging
    )
    r = Renderer(draw_truth("nominal", 3, *size, scene.water.index), scene)
    shown = np.ascontiguousarray(np.broadcast_to(codes, (768, 1024)), np.uint8)
    seen = r.expose("left", [LightSlice(shown, EXPOSURE_S)], 0.0, EXPOSURE_S, 0.0, (False, False), 1).astype(float)
    h, w = seen.shape
    return seen[int(0.4 * h) : int(0.6 * h), int(0.4 * w) : int(0.6 * w)]


def light(code: int, imaging: Imaging) -> float:
    black = picture(np.array([0]), imaging).mean()
    return float(
        (picture(np.array([code]), imaging).mean() - black) / (picture(np.array([240]), imaging).mean() - black)
    )


@pytest.mark.parametrize(("response", "half"), [("linear", 0.5), ("gamma", 0.5**2.2), ("measured", 0.40)])
def test_half_the_code_is_as_much_light_as_the_response_says(response: str, half: float) -> None:
    assert light(120, Imaging(response)) == pytest.approx(half, abs=0.015)


def test_fringes_far_from_the_projectors_focus_keep_their_contrast_only_when_it_has_none() -> None:
    fringes = 127.5 + 119.5 * np.cos(2 * np.pi * (np.arange(1024) + 0.5) / 8)

    def contrast(z_mm: float, defocus: bool) -> float:
        seen = picture(fringes, Imaging("linear", projector_defocus=defocus), z_mm)
        return float((seen.max() - seen.min()) / (seen.max() + seen.min()))

    lost = {on: contrast(FAR, on) / contrast(AT_FOCUS, on) for on in (True, False)}
    assert lost[True] < 0.88
    assert lost[False] == pytest.approx(1.0, abs=0.03)


def test_edges_far_from_the_cameras_focus_are_softer_only_when_it_has_one() -> None:
    def steepest(z_mm: float, defocus: bool) -> float:
        seen = picture(np.array([247]), Imaging(camera_defocus=defocus), z_mm, "checker", (1600, 100))
        return float(np.abs(np.diff(seen, axis=1)).max() / seen.max())

    assert steepest(AT_FOCUS, True) == pytest.approx(steepest(AT_FOCUS, False), rel=0.01)
    assert steepest(FAR, True) < 0.99 * steepest(FAR, False)


def test_a_checker_has_squares_of_ten_millimetres_and_sharp_borders() -> None:
    lattice = noise_lattice()
    x = np.arange(-30.0, 30.0, 0.05)
    seen = np.array([albedo(CHECKER, lattice, float(one), 3.0, 0.0) for one in x])
    assert seen.min() == pytest.approx(0.15)
    assert seen.max() == pytest.approx(0.70)
    borders = x[1:][np.diff(seen > 0.425)]
    assert np.allclose(np.diff(borders), 10.0, atol=0.1)
    assert np.mean((seen > 0.151) & (seen < 0.699)) < 0.02
    across = np.array([albedo(CHECKER, lattice, float(one), 13.0, 0.0) for one in x])
    assert np.allclose(seen + across, 0.85), "the next row is the other way round"


def test_an_unknown_response_is_refused_by_its_name() -> None:
    with pytest.raises(ValueError, match="response 'cubic'; allowed are measured, linear, gamma"):
        Imaging("cubic")
    with pytest.raises(OptionError, match="scene: response 'cubic'"):
        WorldOptions(imaging={"response": "cubic"}).scene()
