"""What lies beside a bright spot in a picture: lines through it make it none, and neighbours do not move its centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.ranging.dots import Lane, contrast_of
from tests.appliance.ranging.test_spots_in_pictures import BEAMS, Bench
from tests.support.truth import WATER


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_a_bright_line_at_any_angle_is_no_dot_anywhere_on_it(angle_deg: int) -> None:
    """A scratch, an edge of a tile, a beam's streak that goes on."""
    y, x = np.mgrid[:61, :61] - 30.0
    turn = np.radians(angle_deg)
    beside = x * np.sin(turn) - y * np.cos(turn)
    line = 200.0 * np.exp(-(beside**2) / 2.0)
    assert contrast_of(line)[20:41, 20:41].max() < 12.0


@pytest.mark.parametrize("towards", [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_a_neighbour_does_not_move_a_spots_centre(towards: tuple[float, float]) -> None:
    """8 px away, seen in the corner of the surroundings; the centre is that of what is round."""
    bench = Bench(400)
    variances = np.diag([9e4, 9e4, 0.0, 0.0])
    anywhere = replace(BEAMS[0], covariance=tuple(tuple(row) for row in variances.tolist()))
    lane = Lane(bench.rig.left, bench.frame, WATER.index, anywhere)
    at = np.array([200.3, 150.6])
    picture = bench.picture((at, 200.0), (at + 5.7 * np.array(towards), 150.0))
    found = lane.candidates(picture)
    assert found
    assert min(float(np.hypot(one.u_px - at[0], one.v_px - at[1])) for one in found) < 0.15
