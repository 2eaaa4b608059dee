"""A fogged window is told from the object and the water: by the other camera, and by staying while the scene changes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.instrument.service.watches import WindowWatch
from appliance.measure.verdicts.window import CELLS, Windows
from hw_sim.optics.fog import Fog
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
from tests.support.fogged import windows_of
from tests.support.rendered import render_scan

WIDTH = 240
CLEAN, CLEAR = Fog(), Water()


@cache
def looked(name: str, distance_mm: float, fog: Fog = CLEAN, water: Water = CLEAR) -> Windows:
    """One scan of an object at rest."""
    scene = Scene(object=name, pose=(4.0, -3.0, distance_mm, 5.0, 8.0, 10.0), fog=fog, water=water)
    return windows_of(render_scan(scene, "realistic", 4, WIDTH, 16))


def test_fog_on_one_window_is_found_where_it_is_and_how_much_of_it() -> None:
    fogged = looked("plane", 520.0, Fog(right=0.4, x=0.7, y=0.3, radius=0.15))
    worst = int(np.nanargmax(fogged.falls["right"]))
    assert (worst % CELLS[0], worst // CELLS[0]) == (5, 1)
    assert fogged.falls["right"][worst] == pytest.approx(0.4, abs=0.08)
    assert np.nanmax(fogged.falls["left"]) < 0.03


def test_a_window_that_is_fogged_all_over_is_found_by_the_other_one() -> None:
    fogged = looked("plane", 520.0, Fog(right=0.4, radius=2.0))
    assert fogged.wholes["right"] == pytest.approx(0.4, abs=0.08)
    assert (fogged.wholes["left"] or 0.0) < 0.03


def test_a_clean_window_stays_clean_before_any_object_and_in_turbid_water() -> None:
    watch = WindowWatch()
    for distance_mm in 3 * (480.0, 520.0):  # to and fro: what belongs to the object stays where it is
        verdict = watch.judge(looked("shell", distance_mm, water=Water(attenuation_per_m=1.0, backscatter=0.2)))
        assert verdict.passed is True, (distance_mm, verdict.text)
