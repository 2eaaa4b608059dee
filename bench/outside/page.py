"""Owns the page ``docs/outside.md``: the tables of this measurement, the product before beside the present one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bench.outside.figures import CALIBRATION, FALSE_ALARMS, SOFT
from bench.outside.parts import PARTS
from bench.outside.picture import draw_families, draw_scene, draw_scenes
from bench.outside.record import Content, read, shown
from bench.verdict.binomial import percent, tally

SCENE = 10_001, 3
"""Seed and number of the scene that is shown."""
TOGETHER = "together"
"""The region of what is counted over several parts."""
SEED = re.compile(r"^<!-- seed (\d+) -->$", re.MULTILINE)


def begin(name: str) -> str:
    """The mark above what is written of the part ``name``."""
    return f"<!-- {name}: written by ./dev bench outside --write-docs -->"


def end(name: str) -> str:
    """The mark below it."""
    return f"<!-- end of {name} -->"


def write_page(data: Path, before: Path, page: Path, pictures: Path) -> None:
    """Write what ``data`` has into the page, ``before`` beside it where that file has the same part, and the pictures.

    A table is that of one part and one seed: those of others stay as they are. Raises ValueError for a page without a part's marks;
    it is left as it was.
    """
    now = read(data)
    old = read(before) if before.exists() else {"parts": {}}
    text = page.read_text(encoding="utf-8")
    for name, seeds in now["parts"].items():
        head, inside, tail = _parted(text, name, page)
        blocks = _blocks(inside) | {int(seed): block(name, seed, one, old) for seed, one in seeds.items()}
        about = PARTS[name].about
        lines = [f"### {about[:1].upper()}{about[1:]}", ""]
        for seed, lines_of in sorted(blocks.items()):
            lines += [f"<!-- seed {seed} -->", lines_of.strip(), ""]
        text = "\n".join([head, "", *lines, tail])
    counted = together(now)
    if counted:
        head, _, tail = _parted(text, TOGETHER, page)
        text = "\n".join([head, "", *counted, "", tail])
    page.write_text(text, encoding="utf-8")
    for seed, one in now["parts"].get("scenes", {}).items():
        if "rows" in one["data"]:
            earlier, found = _same(old, "scenes", seed).get("data", {}), one["data"]
            draw_scene(pictures / "outside-scene.png", *SCENE)
            draw_families(pictures / "outside-families.png", earlier.get("families", []), found["families"])
            draw_scenes(pictures / "outside-scenes.png", earlier.get("scenes", []), shown(found["rows"]["all"]))


def block(name: str, seed: str, part: Content, old: Content) -> str:
    """Return what the page says of one part and seed: how and when it was measured, and its tables."""
    command = f"`./dev bench outside --parts {name} --seed {seed} --count {part['count']}`"
    earlier = _same(old, name, seed)
    lines = [f"Seed {seed}: {command}, measured on {part['measured_on']}.", ""]
    lines += _figures(part["measured"], earlier.get("measured"))
    families = part["data"].get("families")
    if families:
        lines += ["", *_families(families, earlier.get("data", {}).get("families", []))]
    return "\n".join(lines)


def together(content: Content) -> list[str]:
    """Return how many of all normal scans raise a false alarm, soft scenes among them: drawn scenes and scans of the part ``health`` of every
    seed there is. Empty unless both parts are there. Soft scenes are those of a sample, where the scenes' own were not looked at."""
    parts = content["parts"]
    if not {"scenes", "health"} <= parts.keys():
        return []
    asked = [*_measured(parts, "scenes"), *_measured(parts, "health")]
    if not any(one["name"].startswith(f"{SOFT}: ") for one in asked):
        asked += [one for one in _measured(parts, "sample") if one["name"].startswith(f"{SOFT}: ")]
    lines = [
        "### False alarms in all normal scans up to 2 /m",
        "",
        "| | target | scenes, soft scenes, health | now |",
        "|---|---|---:|---:|",
    ]
    for name in (*FALSE_ALARMS, CALIBRATION):
        shares = [one["share"] for one in asked if one["name"].endswith(f"false alarms of {name}") and one.get("share")]
        count, of = (sum(share[k] for share in shares) for k in (0, 1))
        one = tally(f"false alarms of {name}", count, of, at_most=0.0).as_dict()
        parted = " + ".join(f"{share[0]} of {share[1]}" for share in shares)
        lines.append(f"| {one['name']} | {_target(one)} | {parted} | {_now(one)} |")
    return lines


def _measured(parts: Content, name: str) -> list[Content]:
    return [one for part in parts.get(name, {}).values() for one in part["measured"]]


def _parted(text: str, name: str, page: Path) -> tuple[str, str, str]:
    """Return a page up to the mark above a part's figures, these, and the rest from the mark below on. Raises ValueError where marks are
    missing."""
    head, above, rest = text.partition(begin(name))
    inside, below, tail = rest.partition(end(name))
    if not above or not below:
        raise ValueError(
            f"{page}: no place for the figures of {name!r}; needed are the lines {begin(name)!r} and {end(name)!r}"
        )
    return head + above, inside, below + tail


def _blocks(inside: str) -> dict[int, str]:
    """Return what a part's region has now, by seed."""
    _, *parted = SEED.split(inside)
    return {int(seed): lines for seed, lines in zip(parted[::2], parted[1::2], strict=True)}


def _same(old: Content, name: str, seed: str) -> Content:
    """Return what the product before had of that part and seed; of another seed's there is nothing to compare with."""
    found: Content = old["parts"].get(name, {}).get(seed, {})
    return found


def _figures(now: Sequence[Content], old: Sequence[Content] | None) -> list[str]:
    """Return one table; it has a column of the product before where that was measured, too."""
    if old is None:
        lines = ["| | target | now |", "|---|---|---:|"]
        return lines + [f"| {one['name']} | {_target(one)} | {_now(one)} |" for one in now]
    before = {one["name"]: one["value"] for one in old}
    lines = ["| | target | the product before | now |", "|---|---|---:|---:|"]
    for one in now:
        lines.append(f"| {one['name']} | {_target(one)} | {_short(before.get(one['name']))} | {_now(one)} |")
    return lines


def _now(one: Content) -> str:
    """Return the cell of a figure: with as many digits as tell it from a bound that it misses, which is said; or why there is none."""
    if one["value"] is None:
        return f"— ({one['why']})" if one["why"] else "—"
    value, bounds = float(one["value"]), (one["at_least"], one["at_most"])
    share = one.get("share")
    text = percent(share[0] / share[1]) if share and one["unit"].startswith("%") else _short(value)
    for digits in range(4, 12):
        if one["kept"] or float(text) not in bounds:
            break
        text = f"{value:.{digits}g}"
    return f"{text} {one['unit']}".rstrip() + ("" if one["kept"] else " **missed**")


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
        "The same scenes with each family alone" + ("; in brackets the product before:" if before else ":"),
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
