"""The shape of the glow where nothing but lit water is seen, with and without an object that the water blurs beyond recognition."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.verdict.water.beam import FAR_MM, GatheredLight, _beam, gather, shape_of_glow
from tests.support import synthetic

CELLS = (16, 12)
RIG, INDEX = synthetic.calibration().rig, synthetic.WATER.index


def gathered(ends_at_mm: float | None) -> GatheredLight:
    """What the rays of the cells gather on their way to that depth; ``None``: all that there is."""
    camera = RIG.left
    row, column = np.divmod(np.arange(CELLS[0] * CELLS[1]), CELLS[0])
    uv = np.stack(
        [(column + 0.5) * camera.width_px / CELLS[0] - 0.5, (row + 0.5) * camera.height_px / CELLS[1] - 0.5], -1
    )
    origins, directions = camera.rays(uv, INDEX)
    ends = np.full(len(origins), FAR_MM)
    if ends_at_mm is not None:
        ends = (ends_at_mm - origins[:, 2]) / directions[:, 2]
    return gather(_beam(RIG, INDEX), origins, directions, ends)


def glow(per_m: float, mean_dn: float = 20.0) -> NDArray[np.float64]:
    light = gathered(None).backscatter(per_m)
    return np.asarray(mean_dn * light / light.mean())


def surface(per_m: float, mean_dn: float, depth_mm: float) -> NDArray[np.float64]:
    at = gathered(depth_mm)
    light = at.falls * np.exp(-per_m * at.ends_m)
    return np.asarray(mean_dn * light / light.mean())


@pytest.mark.parametrize("per_m", [0.5, 1.5, 2.5, 4.0])
def test_the_glow_of_water_alone_says_how_it_fades(per_m: float) -> None:
    assert shape_of_glow(glow(per_m), CELLS, RIG, INDEX) == pytest.approx(per_m)


@pytest.mark.parametrize("depth_mm", [480.0, 560.0])
def test_a_blurred_object_behind_the_glow_does_not_make_the_water_clearer(depth_mm: float) -> None:
    """A plane in water of 6 per m: a sixth of the light is the plane's, without a fringe; the glow was read as 1.5 per m, that of
    water with nothing before the instrument."""
    seen = glow(2.5, 19.0) + surface(2.5, 3.0, depth_mm)
    found = shape_of_glow(seen, CELLS, RIG, INDEX)
    assert found == pytest.approx(2.5, abs=0.5)


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
