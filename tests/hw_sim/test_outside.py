"""The world ``outside``: families are drawn independently of each other, from ranges with a source, or set by hand."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest

from hw_sim import workshop
from hw_sim.options import OptionError, options_from
from hw_sim.outside import ALL, FAMILIES, Outside, draw_outside
from hw_sim.ranges import Range
from hw_sim.scene import Scene


def test_the_ordinary_world_has_none_of_it() -> None:
    assert Scene().outside == Outside()
    assert options_from({}).scene().outside == Outside()
    assert all(getattr(Outside(), f.name) is None for f in fields(Outside))


def test_every_family_is_a_field_of_the_value_and_has_a_generator_of_its_own() -> None:
    assert set(FAMILIES) == {f.name for f in fields(Outside)}
    numbers = [family.number for family in FAMILIES.values()]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_switching_a_family_off_changes_no_other(name: str) -> None:
    everything = draw_outside(11, list(FAMILIES))
    assert draw_outside(11, [name]) == replace(Outside(), **{name: getattr(everything, name)})
    others = [other for other in FAMILIES if other != name]
    assert draw_outside(11, others) == replace(everything, **{name: None})
    assert draw_outside(11, [name]) == draw_outside(11, [name])
    assert draw_outside(11, [name]) != draw_outside(12, [name])


def numbers_of(value: object, place: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for name, part in value.items():
            yield from numbers_of(part, f"{place} {name}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from numbers_of(part, f"{place} {number}")
    else:
        assert isinstance(value, int | float), place
        yield place, value


def test_a_seed_means_the_same_world_for_ever() -> None:
    """Published figures name seeds: a range that moves, or a draw in another order, would make them figures of another world."""
    written = json.loads(Path(__file__).with_name("world_of_seed_20221.json").read_text(encoding="utf-8"))
    drawn = {name: asdict(getattr(draw_outside(20221, [name]), name)) for name in FAMILIES}
    assert dict(numbers_of(drawn)) == pytest.approx(dict(numbers_of(written)), rel=1e-12)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_strength_that_is_not_given_is_none_of_it(name: str) -> None:
    drawn = asdict(getattr(draw_outside(1, [name]), name))
    neutral = asdict(FAMILIES[name].kind())
    assert drawn != neutral
    assert options_from({"outside": {name: {}}}).scene().outside == replace(Outside(), **{name: FAMILIES[name].kind()})


def test_options_draw_the_set_and_take_strengths_by_hand() -> None:
    drawn = options_from({"outside": {"seed": 3}}).scene().outside
    assert drawn == draw_outside(3, ALL)
    assert options_from({"outside": {"seed": 3, "families": ["clocks"]}}).scene().outside == draw_outside(3, ["clocks"])
    by_hand = options_from({"outside": {"seed": 3, "clocks": {"walk_us": 7.0}}}).scene().outside
    assert drawn.clocks is not None
    assert by_hand == replace(drawn, clocks=replace(drawn.clocks, walk_us=7.0))
    alone = options_from({"outside": {"clocks": {"walk_us": 7.0}}}).scene().outside
    assert alone == Outside(clocks=FAMILIES["clocks"].kind(walk_us=7.0))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"sed": 3}, "outside: unknown 'sed'; did you mean 'seed'?"),
        ({"seed": 3, "families": ["clock"]}, "outside: family 'clock'; allowed are .*clocks"),
        ({"families": ["clocks"]}, "families without a seed; add seed = 1"),
        ({"seed": -1}, "seed = -1; allowed are whole numbers from 0"),
        ({"seed": 1, "families": "clocks"}, "families = 'clocks'; give a list"),
        ({"clocks": {"walk": 1.0}}, "outside clocks: unknown 'walk'"),
        ({"clocks": {"walk_us": -1.0}}, "clocks: walk_us = -1.0; allowed are 0..1000"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(table: dict[str, object], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        options_from({"outside": table}).scene()


def test_a_range_without_a_source_or_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(ValueError, match="no source"):
        Range(0.0, 1.0, " ")
    with pytest.raises(ValueError, match="the lower end comes first"):
        Range(1.0, 0.0, "somebody")


LIMITS: dict[str, dict[str, tuple[float, float]]] = {
    "backscatter": {"scattering_share": (0.0, 0.99), "index": (1.01, 1.3), "slope": (3.01, 4.9)},
    "projector": {
        "cycles": (0, 16), "order": (0, 2**31), "dark_part": (0.0, 0.5), "frame_rms": (0.0, 0.1), "droop": (0.0, 0.5),
        "droop_s": (0.01, 100.0), "hot_spot": (0.0, 0.9), "hot_x": (-0.5, 0.5), "hot_y": (-0.5, 0.5), "hot_width": (0.1, 2.0),
        "focus_bend_mm": (-100.0, 100.0), "focus_tilt_x_mm": (-100.0, 100.0), "focus_tilt_y_mm": (-100.0, 100.0),
        "led_shift_nm": (-30.0, 30.0), "led_width_nm": (0.0, 60.0), "led_nm_per_k": (0.0, 0.2),
    },
    "surfaces": {
        "white": (0.01, 1.0), "gloss_index": (1.0, 2.0), "roughness": (0.02, 1.0), "below_part": (0.0, 1.0),
        "below_mm": (0.01, 20.0), "bounce": (0.0, 1.0),
    },
    "lens": {
        "field_px": (0.0, 5.0), "fall": (0.0, 8.0), "dent_px": (0.0, 5.0), "dent_width_px": (80.0, 800.0),
        "stria_px": (0.0, 5.0), "stria_width_px": (60.0, 800.0), "pupil_mm": (-5.0, 5.0),
    },
    "plates": {
        "board_saddle_mm": (-0.2, 0.2), "board_twist_mm": (-0.2, 0.2), "board_s_mm": (-0.2, 0.2),
        "plane_saddle_mm": (-0.2, 0.2), "plane_twist_mm": (-0.2, 0.2), "plane_s_mm": (-0.2, 0.2),
    },
    "cameras": {
        "full_well_e": (100.0, 1e6), "read_noise_e": (0.0, 1e3), "black_dn": (0.0, 64.0), "prnu": (0.0, 0.1),
        "dsnu_e": (0.0, 1e3), "nonlinearity": (-0.1, 0.1), "corner_loss": (0.0, 0.9), "row_noise_e": (0.0, 1e3),
        "hot_per_million": (0.0, 1e5), "glare": (0.0, 0.5),
    },
    "hands": {
        "jerk_mm_s3": (-1e5, 1e5), "swell_mm": (-100.0, 100.0), "shoulder_deg": (-10.0, 10.0), "shoulder_mm": (-5e3, 5e3),
        "swell_hz": (math.ulp(0.0), 30.0), "shoulder_hz": (math.ulp(0.0), 30.0),
    },
    "mounts": {
        "left_deg_per_k": (-0.1, 0.1), "right_deg_per_k": (-0.1, 0.1), "projector_deg_per_k": (-0.1, 0.1),
        "focal_per_k": (-1e-3, 1e-3), "depth_m": (0.0, 300.0), "window_radius_mm": (5.0, 60.0),
    },
    "soft": {"wave_mm": (0.0, 5.0), "length_mm": (60.0, 1000.0), "wave_hz": (0.01, 10.0)},
    "clocks": {
        "board_jitter_us": (0.0, 1e3), "camera_jitter_us": (0.0, 1e3), "wander_ppm": (0.0, 1e3), "walk_us": (0.0, 1e3),
        "stamps_at_end": (0, 1),
    },
}  # fmt: skip
"""What each strength may be when it is given by hand, both ends included. Of a vector, each of its three numbers."""
PHASES = {"swell_phase_rad", "shoulder_phase_rad", "phase_rad"}
"""Any angle is one."""


@pytest.mark.parametrize("name", list(FAMILIES))
def test_each_strength_is_taken_up_to_its_limits_and_refused_beyond_by_its_name(name: str) -> None:
    kind = FAMILIES[name].kind
    assert LIMITS[name].keys() == {f.name for f in fields(kind)} - PHASES
    for strength, (least, most) in LIMITS[name].items():
        usual = getattr(kind(), strength)
        whole = isinstance(usual, int)
        less, more = (
            (least - 1, most + 1) if whole else (math.nextafter(least, -math.inf), math.nextafter(most, math.inf))
        )
        for value in (least, most):
            for given in spread(usual, value):
                assert getattr(kind(**{strength: given}), strength) == given
        for value in (less, more):
            for given in spread(usual, value):
                with pytest.raises(ValueError, match=f"{name}: {strength} = .*; (allowed are|give three numbers)"):
                    kind(**{strength: given})


def spread(usual: object, value: float) -> list[object]:
    """Return what to give for a strength: the number, or for a vector each of its places with it in turn."""
    if not isinstance(usual, tuple):
        return [value]
    return [tuple(value if place == at else 0.0 for place in range(3)) for at in range(3)]


def test_a_vector_has_three_numbers() -> None:
    for name in ("hands", "mounts"):
        for strength in (one for one in LIMITS[name] if isinstance(getattr(FAMILIES[name].kind(), one), tuple)):
            for given in ((0.0, 0.0), (0.0, 0.0, 0.0, 0.0)):
                with pytest.raises(ValueError, match=f"{name}: {strength} = .*; give three numbers"):
                    FAMILIES[name].kind(**{strength: given})


def test_the_page_says_which_ranges_are_estimates() -> None:
    tables = {name: sys.modules[family.kind.__module__].RANGES for name, family in FAMILIES.items()}
    tables["workshop"] = workshop.RANGES
    page = (Path(__file__).parents[2] / "docs/outside-world.md").read_text(encoding="utf-8")
    rows = [
        line.split("|")[1:-1] for line in page.partition("| family | from sources |")[2].splitlines()[2:] if "|" in line
    ]
    said = {cells[0].strip(" `"): [set(re.findall("`(.+?)`", cell)) for cell in cells[1:]] for cells in rows}
    for family, table in tables.items():
        marks = {name: r.source.partition(":")[0] for name, r in table.items()}
        estimated = {name for name, mark in marks.items() if mark == "estimate"}
        in_part = {name for name, mark in marks.items() if mark == "partly estimate"}
        assert said[family] == [marks.keys() - estimated - in_part, in_part, estimated], family
    assert said.keys() == tables.keys()


NOT_ZERO: dict[str, dict[str, object]] = {
    "backscatter": {"index": 1.10, "slope": 3.5835},
    "projector": {"droop_s": 1.0, "hot_width": 0.3},
    "surfaces": {"white": 0.6, "gloss_index": 1.0, "roughness": 0.3, "below_mm": 0.3},
    "lens": {"fall": 1.0, "dent_width_px": 120.0, "stria_width_px": 100.0},
    "cameras": {"full_well_e": 11_000.0, "read_noise_e": 9.0, "black_dn": 3.0, "prnu": 0.006, "dsnu_e": 5.0},
    "hands": {"swell_hz": 1.0, "shoulder_hz": 1.0, "shoulder_mm": (180.0, -200.0, -450.0)},
    "mounts": {"window_radius_mm": 25.0},
    "soft": {"length_mm": 120.0, "wave_hz": 1.0},
}
"""Sizes, rates and indices of what has no amount yet, and the common sensor that a camera has at least."""


@pytest.mark.parametrize("name", list(FAMILIES))
def test_what_is_not_given_is_nothing(name: str) -> None:
    given = asdict(FAMILIES[name].kind())
    assert {key: value for key, value in given.items() if np.any(value)} == NOT_ZERO.get(name, {})
