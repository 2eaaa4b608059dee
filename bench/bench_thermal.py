"""Temperatures of a dive of 100 scans: in cold and warm water, after an hour on deck, and without sensors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from appliance.instrument.machine.states import Settings
from bench.result import Measurement
from bench.thermal.dive import Dive, boat_then_dive, dive_of
from bench.turbidity.plot import Line, Panel, draw

SCANS = 100
DECK_MINUTES = 60.0
PAGE, PICTURE = Path("docs", "thermal.md"), Path("docs", "pictures", "thermal.png")


def dives(scans: int = SCANS) -> Iterator[tuple[str, Dive]]:
    """Yield each case with its name on the page."""
    for water_c in (4.0, 20.0, 30.0):
        yield f"{scans} scans in water of {water_c:g} °C", dive_of(scans, water_c)
    yield f"{scans} scans in water of 20 °C, no sensor answers", dive_of(scans, 20.0, sensors=False)
    yield "an hour on deck in 42 °C, then in water of 30 °C", boat_then_dive(scans // 2, 42.0, 30.0, DECK_MINUTES)
    always_on = boat_then_dive(scans // 2, 42.0, 30.0, DECK_MINUTES, policy=False)
    yield "the same, were its light never to rest", always_on


def measure() -> Iterable[Measurement]:
    """Measure the highest temperatures of each dive, against the limits at which scans are blocked."""
    limits = Settings().temperatures
    for name, dive in dives():
        within = "never to rest" not in name
        for place, values in (
            ("case", [sample.case_c for sample in dive.samples]),
            ("projector", [sample.projector_c for sample in dive.samples]),
        ):
            bound = limits[place].hot_c if within else None
            yield Measurement(f"{name}: warmest {place}", max(values), "°C", at_most=bound)


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench thermal --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench thermal", description=__doc__)
    parser.add_argument("--scans", type=int, default=SCANS, help="of a dive")
    parser.add_argument("--write-docs", action="store_true", help=f"write {PAGE} and its picture")
    options = parser.parse_args(arguments)
    if not 2 <= options.scans <= 1000:
        parser.error(f"--scans {options.scans}: allowed are 2 to 1000")
    results = list(dives(options.scans))
    table = rows(results)
    sys.stdout.write("\n".join(table) + "\n")
    if options.write_docs:
        PAGE.write_text(page(table), encoding="utf-8")
        draw(PICTURE, [panel(name, dive) for name, dive in results])
    return 0


def rows(done: Sequence[tuple[str, Dive]]) -> list[str]:
    """Return the table with a line for each dive."""
    lines = [
        "| dive | lasts | scans | refused | light | warmest case | warmest projector | warmest camera |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, dive in done:
        worst = [
            max(values) for values in zip(*((s.case_c, s.projector_c, s.camera_c) for s in dive.samples), strict=True)
        ]
        share = 100.0 * dive.light_s / (60.0 * dive.samples[-1].minute)
        warmest = " | ".join(f"{value:.1f} °C" for value in worst)
        lines.append(
            f"| {name} | {dive.samples[-1].minute:.0f} min | {dive.scans} | {sum(dive.refused.values())} | {share:.0f} % | "
            f"{warmest} |"
        )
    return lines


def panel(name: str, dive: Dive) -> Panel:
    """Return the plot of the temperatures over time, with the limits as horizontal lines."""
    minutes = [sample.minute for sample in dive.samples]
    last = max(10.0, -(-minutes[-1] // 20) * 20)
    limits = Settings().temperatures
    ends = [0.0, last]
    lines = [
        Line("projector", minutes, [sample.projector_c for sample in dive.samples]),
        Line("camera", minutes, [sample.camera_c for sample in dive.samples]),
        Line("case", minutes, [sample.case_c for sample in dive.samples]),
        Line("projector hot", ends, [limits["projector"].hot_c] * 2),
        Line("case hot", ends, [limits["case"].hot_c] * 2),
    ]
    marks = [round(last * k / 4) for k in range(5)]
    return Panel(f"{name} (°C over minutes)", lines, marks, [0, 20, 40, 60, 80, 100])


def page(table: Sequence[str]) -> str:
    """Return the text of docs/thermal.md."""
    return f"""# Heat

Heat limits an instrument in a closed housing. `appliance/instrument/machine/thermal.py` decides by two temperatures, of case and projector. Their
limits are in the rig file (`[limits]`). Each band ends 3 °C below where it began:

| band | what happens | the diver sees |
|---|---|---|
| normal | the light goes out after 180 s without a key | – |
| warm | the light goes out after 30 s | WARM 51 °C |
| hot | no light and no scans until it is cool: state COOLING | HOT 61 °C, and about how long it takes |
| too hot | the current scan is saved, then the instrument switches off | TOO HOT |
| unknown: a sensor is silent for 5 s | 20 s of light in a minute, 5 s of which aiming leaves for scans | TEMP ? |

The next key brings the light back. The time to cool follows from the straight line T(t) through the last minute:

    t = (T − T_end)/(−dT/dt)

## Figures: a dive of {SCANS} scans

    ./dev bench thermal --write-docs

The instrument decides, and the simulated housing (`hw_sim/heat.py`) warms up. The diver aims for 25 s, looks at each cloud for 6 s, and keeps
it. *Light* is the share of the time that the projector shines.

{chr(10).join(table)}

![Temperatures](pictures/{PICTURE.name})

## Limits

The housing is a model: masses and conductances of an aluminium cylinder, not measured on one.
"""
