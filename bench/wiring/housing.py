"""Figures of docs/build/housing.md that follow from the rig file: ``./dev run python -m bench.wiring.housing``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from appliance.measure.light.water import quan_fry_index
from appliance.store.config import Rig, load_rig

PAGE = Path(__file__).parents[2] / "docs" / "build" / "housing.md"
BEGIN, END = "<!-- figures begin -->", "<!-- figures end -->"
STEEP_PX = 0.03
"""Deviation that has no effect: the residual of the best calibration (docs/calibration.md)."""
RIM_MM = 3.0
"""Room around the beam for alignment."""
SEAT_MM = 5.0
"""Width of the seat outside of the clear opening, for the seal."""
SAPPHIRE_GPA = 400.0
"""Young's modulus of sapphire, roughly: it depends on the crystal's axis."""
BAR_MPA = 0.1
FNUMBER = 8.0


@dataclass(frozen=True, slots=True)
class Window:
    """One camera's window as drawn."""

    half_field_deg: float
    clear_mm: float
    """Diameter that the beam of the image's corner needs, with the rim."""
    slope_inner_urad: float
    slope_outer_urad: float
    """Slope of a surface that turns a ray in water by ``STEEP_PX``."""
    bow_um_at_100_m: float
    bow_px_at_100_m: float


def window(rig: Rig) -> Window:
    design, camera = rig.design, rig.camera.left
    half_mm = 0.5 * design.pixel_um * 1e-3 * math.hypot(camera.width_px, camera.height_px)
    field = math.atan(half_mm / design.principal_distance_mm)
    # The beam has the width of the lens's pupil, and goes on within the glass at Snell's angle.
    pupil_mm = design.principal_distance_mm / FNUMBER
    within = math.asin(math.sin(field) / design.port_index)
    beam_mm = 2.0 * (design.port_distance_mm * math.tan(field) + design.port_thickness_mm * math.tan(within)) + pupil_mm
    clear_mm = beam_mm + 2.0 * RIM_MM
    water = quan_fry_index(rig.water.temperature_c, rig.water.salinity_psu, rig.water.wavelength_nm)
    px_rad = design.pixel_um * 1e-3 / design.principal_distance_mm / water
    # A small turn of one surface turns the ray by the difference of the indices it stands between (prism, small angles).
    inner, outer = (design.port_index - 1.0) / water, (design.port_index - water) / water
    # A round plate, simply supported at its seat, under even pressure: bow in the middle, and slope where the beam ends (Poisson 0.3).
    seat_mm = 0.5 * clear_mm + SEAT_MM
    stiff = SAPPHIRE_GPA * 1e3 * design.port_thickness_mm**3
    pressure_mpa = 10.0 * BAR_MPA
    bow_mm = 0.696 * pressure_mpa * seat_mm**4 / stiff
    slope = 4.0 * bow_mm / (2.0 * seat_mm) * (0.5 * beam_mm / seat_mm)
    return Window(
        math.degrees(field),
        clear_mm,
        1e6 * STEEP_PX * px_rad / inner,
        1e6 * STEEP_PX * px_rad / outer,
        1e3 * bow_mm,
        slope * (inner - outer) / px_rad,
    )


def table() -> str:
    """Return the page's table, for the packaged rig file."""
    rig = load_rig()
    design, port = rig.design, window(rig)
    rows = (
        ("length of the baseline", f"{design.baseline_mm:g} mm", "`baseline_mm`"),
        ("each camera turned inwards by", f"{design.toe_in_deg:g}°", "`toe_in_deg`"),
        ("projection centre to the port's inner face", f"{design.port_distance_mm:g} mm", "`port_distance_mm`"),
        ("port", f"{design.port_thickness_mm:g} mm thick, index {design.port_index:g} (sapphire)", "`port_thickness_mm`, `port_index`"),
        ("working volume, from between the projection centres", f"{rig.volume.nearest_mm:g} to {rig.volume.farthest_mm:g} mm", "`[volume]`"),
        ("half of a camera's field, to the corner, in air", f"{port.half_field_deg:.1f}°", "from lens and sensor"),
        ("clear opening of a camera's port", f"{port.clear_mm:.0f} mm", f"beam at f/{FNUMBER:g}, and {RIM_MM:g} mm around it"),
        (f"slope of the inner face that moves a point by {STEEP_PX:g} px", f"{port.slope_inner_urad:.0f} µrad", "prism"),
        ("the same of the outer face", f"{port.slope_outer_urad:.0f} µrad", "prism"),
        ("bow of the port at 100 m", f"{port.bow_um_at_100_m:.1f} µm", f"plate on a seat {SEAT_MM:g} mm wider all around"),
        ("what that moves at the image's corner", f"{port.bow_px_at_100_m:.2f} px", "both faces bow alike"),
    )  # fmt: skip
    lines = [
        "| what | value | from |",
        "|---|---|---|",
        *(f"| {what} | {value} | {source} |" for what, value, source in rows),
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    head, remainder = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(f"{head}{BEGIN}\n{table()}\n{END}{remainder.split(END)[1]}", encoding="utf-8")
    print(table())
