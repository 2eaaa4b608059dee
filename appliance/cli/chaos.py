"""``kingfisher sim chaos=SEED``: what an unlucky dive was told is compared with what lies on the disk."""

from __future__ import annotations

import json as json_format
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.cli.output import Exit, Progress, UsageError
from appliance.cli.simrig import SimOptions, simulated
from appliance.store import Library, UnknownScan

if TYPE_CHECKING:
    from appliance.store import Rig

OPTION = "chaos"
"""Name of the option of the simulated world (docs/protocols/world.md)."""


@dataclass(frozen=True, slots=True)
class Chaos:
    """An unlucky dive: the seed of everything that happens, and how often SCAN is pressed."""

    seed: int
    scans: int


def chaos(
    rig: Rig,
    options: SimOptions,
    wanted: Chaos,
    dive: Callable[[Rig, SimOptions], Exit],
    tell: Callable[[Any, Iterable[str]], None],
) -> Exit:
    """Dive while devices come and go; FAILED if an accepted scan is lost or damaged or a refusal had no reason.

    ``dive`` runs the instrument of a rig in its simulated world until that ends.
    """
    if options.script is not None or options.window:
        raise UsageError("chaos: its diver holds the instrument; leave --script and --window out")
    root = options.root or rig.storage.root
    # Scans of before would be counted as saved by this dive, and its losses would be hidden among them.
    if (root / "scans").exists():
        raise UsageError(f"--root {root}: holds scans already; chaos counts what it left, so give a new folder")
    with tempfile.TemporaryDirectory(prefix="kingfisher-chaos-") as folder:
        report = Path(folder) / "report.json"
        # The world says what it told the diver in a file of its own: only by that, not by the instrument's word, is the
        # disk judged.
        chosen = {OPTION: {"seed": wanted.seed, "scans": wanted.scans, "report": str(report)}, "stills": True}
        # Handed on unread, as all options of a simulated world: the product knows the name of this one and nothing
        # else.
        world = replace(rig.rig, wires_options={**rig.rig.wires_options, **chosen})
        ended = dive(replace(rig, rig=world), options)
        told: dict[str, Any] = json_format.loads(report.read_text(encoding="utf-8"))
    result = told | _compared(simulated(replace(rig, rig=world), options), told["accepted"])
    tell(result, (f"{key:<12} {_short(value)}" for key, value in result.items()))
    whole = not (result["lost"] or result["damaged"] or result["unexplained"])
    # How the service ended comes before what the comparison found: after a crash the rest is its consequence.
    return ended if ended is not Exit.OK else Exit.OK if whole else Exit.FAILED


def _compared(rig: Rig, accepted: list[str]) -> dict[str, Any]:
    """Verify the scans that the screen called saved. Return the lost ones, the damaged ones and how many scans there are."""
    library = Library(rig.storage.root)
    lost, damaged = [], []
    with Progress() as progress:
        for k, scan_id in enumerate(accepted):
            progress(f"verifying {scan_id}", k / len(accepted))
            try:
                if not library.verify(scan_id).ok:
                    damaged.append(scan_id)
            except UnknownScan:
                lost.append(scan_id)
    return {"lost": lost, "damaged": damaged, "saved": library.count()}


def _short(value: object) -> str:
    match value:
        case dict():
            return ", ".join(f"{key} {number}" for key, number in sorted(value.items())) or "-"
        case list():
            return f"{len(value)}" + (f": {value[0]}" if value and isinstance(value[0], str) and len(value) < 3 else "")
        case _:
            return str(value)
