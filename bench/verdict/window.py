"""Accuracy of the watch over the ports: alarms on clean ones, and detected fog of known strength.

A dive is six scans of random objects, each in its own water, with one hidden rig. Its ports are clean, or one region of
one of them is fogged, which scatters a share of the light there. The watch is updated as on the instrument. It needs
three scans of the region, and not every object lies before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from appliance.instrument.service.watches import WindowWatch
from appliance.measure.fault import FaultCode
from appliance.measure.light.sides import SIDES
from appliance.measure.verdicts.window import Windows
from bench.result import Measurement
from bench.turbidity.scenes import drawn_scene
from bench.verdict.parts import Say
from hw_sim.optics.fog import Fog
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support.fogged import windows_of
from tests.support.rendered import render_scan

WIDTH_PX, PERIOD_PX = 240, 16
DIVE, LEAST = 6, 3
"""Number of scans of a dive, and least number for the watch."""
STRENGTHS = (0.15, 0.25, 0.35, 0.5)
"""Share of the light that is thrown aside."""
TOLD_FROM, MOST_MISSED = 0.35, 0.25
"""Strength above which fog must be detected in a dive, and share of dives that may miss it because too little was
visible."""
MOST_ATTENUATION_PER_M = 2.0


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` with clean ports, and as many with each strength of fog; at least one dive each."""
    clean = max(1, scans // DIVE)
    fogged = max(1, scans // DIVE)
    dives = [(0.0, k) for k in range(clean)] + [(strength, k) for strength in STRENGTHS for k in range(fogged)]
    rows = []
    for done, (strength, k) in enumerate(dives):
        say("windows", done / len(dives))
        rows.append(_dive(np.random.default_rng([seed, round(100 * strength), k, 44]), strength))
    return _figures(rows), {"dives": rows}


def _dive(rng: np.random.Generator, strength: float) -> dict[str, Any]:
    """Return the scans of a dive, and the reported ports after them."""
    side = str(rng.choice(SIDES))
    place = (float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.1, 0.2)))
    fog = Fog(**{side: strength}, x=place[0], y=place[1], radius=place[2]) if strength else Fog()
    rig_seed, watch, falls, reported = int(rng.integers(1, 10_000)), WindowWatch(), [], set[str]()
    after: list[list[str]] = []
    scenes: list[Scene] = []
    for _ in range(DIVE):
        water = turbid(float(np.exp(rng.uniform(np.log(0.1), np.log(MOST_ATTENUATION_PER_M)))))
        scenes.append(drawn_scene(rng, water))
        windows = _looked(scenes[-1], fog, rig_seed)
        watch.judge(windows)
        reported |= {str(device) for code, device, fault in watch.conditions() if fault and code is FaultCode.WINDOW}
        after.append(sorted(reported))
        side_falls = windows.falls[side]
        falls.append(None if np.isnan(side_falls).all() else float(np.nanmax(side_falls)))
    return {
        "strength": strength,
        "side": side if strength else None,
        "place": place,
        "scenes": [f"{scene.object}, fringes fall by {scene.water.attenuation_per_m:.2f}/m" for scene in scenes],
        "told": sorted(reported),
        "told_after_least": after[LEAST - 1],
        "most_fall": falls,
    }


def _looked(scene: Scene, fog: Fog, seed: int) -> Windows:
    return windows_of(render_scan(replace(scene, fog=fog), "realistic", seed, WIDTH_PX, PERIOD_PX))


def _figures(rows: Sequence[dict[str, Any]]) -> list[Measurement]:
    clean = [row for row in rows if not row["strength"]]
    wrong = sum(bool(row["told"]) for row in clean)
    figures = [
        Measurement(f"clean windows, {DIVE * len(clean)} scans: dives with an alarm", wrong, "dives", at_most=0),
        Measurement("clean windows: largest fall of a cell", _most(clean), "", None),
    ]
    for strength in STRENGTHS:
        fogged = [row for row in rows if row["strength"] == strength]
        soon, right = (
            float(np.mean([row[when] == [f"camera.{row['side']}"] for row in fogged]))
            for when in ("told_after_least", "told")
        )
        wrong = sum(any(device != f"camera.{row['side']}" for device in row["told"]) for row in fogged)
        must = 1.0 - MOST_MISSED if strength >= TOLD_FROM else None
        figures += [
            Measurement(f"fog {strength:g}, {len(fogged)} dives: named in {LEAST} scans", soon, "share"),
            Measurement(f"fog {strength:g}: named in {DIVE} scans", right, "share", at_least=must),
            Measurement(f"fog {strength:g}: the other window named", wrong, "dives", at_most=0),
            Measurement(f"fog {strength:g}: read as, median", _median(fogged), "", None),
        ]
    return figures


def _most(rows: Sequence[dict[str, Any]]) -> float:
    falls = [fall for row in rows for fall in row["most_fall"] if fall is not None]
    return max(falls, default=float("nan"))


def _median(rows: Sequence[dict[str, Any]]) -> float:
    falls = [fall for row in rows for fall in row["most_fall"] if fall is not None]
    return float(np.median(falls)) if falls else float("nan")
