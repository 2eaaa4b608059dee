"""Owns the page ``docs/outside.md``: the tables of this measurement, the product before beside the present one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.outside.figures import is_soft
from bench.outside.kept import Row
from bench.outside.parts import PARTS
from bench.outside.picture import draw_families, draw_scene, draw_scenes

BEGIN, END = "<!-- figures: written by ./dev bench outside --write-docs -->", "<!-- end of figures -->"
SCENE = 10_001, 3
"""Seed and number of the scene that is shown."""
Content = Mapping[str, Any]


def write_page(data: Path, before: Path, page: Path, pictures: Path) -> None:
    """Write the figures of ``data`` between the page's marks, those of ``before`` beside them where that file is there, and the
    pictures. Raises ValueError for a page without marks."""
    now = json.loads(data.read_text(encoding="utf-8"))
    old = json.loads(before.read_text(encoding="utf-8")) if before.exists() else {"parts": {}}
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page}: no place for figures; needed are the lines {BEGIN!r} and {END!r}")
    head, rest = text.split(BEGIN, 1)
    tail = rest.split(END, 1)[1]
    page.write_text(f"{head}{BEGIN}\n\n{tables(now, old)}\n{END}{tail}", encoding="utf-8")
    draw_scene(pictures / "outside-scene.png", *SCENE)
    if "scenes" in now["parts"]:
        earlier, found = old["parts"].get("scenes", {}).get("data", {}), now["parts"]["scenes"]["data"]
        draw_families(pictures / "outside-families.png", earlier.get("families", []), found["families"])
        draw_scenes(pictures / "outside-scenes.png", earlier.get("scenes", []), shown(found["rows"]["all"]))


def tables(now: Content, old: Content) -> str:
    """Return the tables of all parts, in the order of ``PARTS``."""
    lines = [f"Seed {now['seed']}" + (f"; of the product before, seed {old['seed']}." if "seed" in old else "."), ""]
    for name, entry in PARTS.items():
        part = now["parts"].get(name)
        if part is None:
            continue
        lines += [f"### {entry.about[:1].upper()}{entry.about[1:]}", ""]
        lines += _figures(part["measured"], old["parts"].get(name, {}).get("measured", []))
        if name == "scenes":
            earlier = old["parts"].get(name, {}).get("data", {}).get("families", [])
            lines += ["", *_families(part["data"]["families"], earlier)]
        lines.append("")
    return "\n".join(lines)


def compact(content: Content) -> dict[str, Any]:
    """Return the content without most of what is known of single scans and rigs, small enough to be kept beside the page."""
    parts = {}
    for name, part in content["parts"].items():
        kept = {k: v for k, v in part["data"].items() if k == "families"}
        if name == "scenes":
            kept["scenes"] = shown(part["data"]["rows"]["all"])
        parts[name] = {"measured": part["measured"], "data": kept}
    return {**content, "parts": parts}


def shown(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return what the picture of all scenes shows of them, without the soft ones."""
    keys = ("attenuation_per_m", "complete_percent", "error_over_sigma", "accepted")
    return [{key: row[key] for key in keys} for row in rows if not is_soft(row)]


def _figures(now: Sequence[Content], old: Sequence[Content]) -> list[str]:
    before = {one["name"]: one["value"] for one in old}
    lines = ["| | target | the product before | now |", "|---|---|---:|---:|"]
    for one in now:
        missed = "" if one["kept"] else " **missed**"
        lines.append(
            f"| {one['name']} | {_target(one)} | {_short(before.get(one['name']))} | {_short(one['value'])} {one['unit']}{missed} |"
        )
    return lines


def _target(one: Content) -> str:
    low, high = one["at_least"], one["at_most"]
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    if low is not None:
        return f"≥ {low:g}"
    return "" if high is None else f"≤ {high:g}"


def _families(now: Sequence[Content], old: Sequence[Content]) -> list[str]:
    before = {one["name"]: one for one in old}
    lines = [
        "The same scenes with each family alone; in brackets the product before:",
        "",
        "| family | scenes | accepted | complete % | outliers ppm, all scans | error over sigma | largest | rms µm | faults |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for one in now:
        then = before.get(one["name"], {})
        cells = [f"{one['name']} | {one['scenes']}"]
        for key in (
            "accepted",
            "complete_percent",
            "outliers_all_ppm",
            "error_over_sigma",
            "error_over_sigma_most",
            "rms_um",
        ):
            was = f" ({_short(then.get(key))})" if then else ""
            cells.append(f"{_short(one[key])}{was}")
        cells.append(", ".join(f"{code} {count}" for code, count in sorted(one["faults"].items())))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _short(value: float | None) -> str:
    if value is None:
        return "—"
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
