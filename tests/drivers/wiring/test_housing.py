"""The figures of the housing's page are those of the packaged rig file, by an optics of their own."""

from __future__ import annotations

import math

from appliance.config import default_rig_path, load_rig
from tests.drivers.wiring.housing import BEGIN, END, PAGE, STEEP_PX, table, window

RIG = load_rig(default_rig_path())
INDEX = 1.335
"""Fresh water at 530 nm."""


def refracted(direction: tuple[float, float], normal_tilt: float, before: float, after: float) -> tuple[float, float]:
    """Return a ray behind a surface whose normal is tilted in the plane of x and z: Snell's law by angles."""
    angle = math.atan2(direction[0], direction[1]) - normal_tilt
    behind = math.asin(math.sin(angle) * before / after) + normal_tilt
    return math.sin(behind), math.cos(behind)


def turned(inner_tilt: float, outer_tilt: float) -> float:
    """Return the angle in water of the axis's ray."""
    within = refracted((0.0, 1.0), inner_tilt, 1.0, RIG.design.port_index)
    out = refracted(within, outer_tilt, RIG.design.port_index, INDEX)
    return math.atan2(*out)


def test_the_pages_table_is_what_the_rig_file_makes() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.split(BEGIN)[1].split(END)[0].strip() == table(), (
        "write it again: ./dev run python -m tests.drivers.wiring.housing"
    )


def test_the_slopes_turn_a_traced_ray_by_what_they_say() -> None:
    made = window(RIG)
    allowed = STEEP_PX * RIG.design.pixel_um * 1e-3 / RIG.design.principal_distance_mm / INDEX
    for inner, outer in ((made.slope_inner_urad, 0.0), (0.0, made.slope_outer_urad)):
        assert abs(abs(turned(inner * 1e-6, outer * 1e-6)) / allowed - 1.0) < 0.02
    # Bowed alike, both faces nearly cancel: what is left is that of a thin shell of water.
    alike = turned(made.slope_inner_urad * 1e-6, made.slope_inner_urad * 1e-6)
    assert abs(alike) < abs(turned(made.slope_inner_urad * 1e-6, 0.0))


def test_the_opening_lets_the_corners_beam_through() -> None:
    made = window(RIG)
    half_mm = 0.5 * 4.5e-3 * math.hypot(1600, 1200)
    x = 30.0 * half_mm / 11.5
    inside = refracted((half_mm, 11.5), 0.0, 1.0, 1.77)
    x += 5.0 * inside[0] / inside[1]
    assert x + 0.5 * 11.5 / 8.0 < 0.5 * made.clear_mm < x + 6.0
