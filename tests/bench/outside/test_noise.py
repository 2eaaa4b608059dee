"""What the instrument knows of its cameras' noise in the world ``outside``."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.outside.noise import WAYS
from bench.outside.world import world_of
from hw_sim.scene import Scene


@pytest.mark.parametrize("seed", [10_011, 10_012])
def test_noise_that_is_measured_is_that_of_the_cameras(seed: int, tmp_path: Path) -> None:
    """Within an eighth of the noise: rows that flicker, which no data sheet states, come on top."""
    world = world_of(Scene(), seed, ("cameras",))
    told, sheet = (WAYS[how](world, 0.0, tmp_path) for how in ("measured", "sheet"))
    for grey_dn in (60.0, 160.0):
        assert told.left.variance_dn2(grey_dn) == pytest.approx(sheet.left.variance_dn2(grey_dn), rel=0.25)
        assert told.right.variance_dn2(grey_dn) == pytest.approx(sheet.right.variance_dn2(grey_dn), rel=0.25)


def test_gain_multiplies_what_was_measured_without(tmp_path: Path) -> None:
    world = world_of(Scene(), 10_011, ("cameras",))
    at_rest, louder = (WAYS["measured"](world, gain_db, tmp_path) for gain_db in (0.0, 6.0))
    assert louder.left.dn_per_e == pytest.approx(at_rest.left.dn_per_e * 10.0 ** (6.0 / 20.0), rel=1e-6)
