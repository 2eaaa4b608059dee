"""Owns the frames and the rows that this measurement keeps in a folder: rendered once, judged again whenever the product changes.

A frame's name holds everything that its picture depends on here; a row's name holds the product's sources as well. The
simulator's own state is in neither: an empty folder starts anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import PatternSequence
from appliance.measure.light.response import Response
from appliance.measure.light.sides import SIDES
from bench.outside.world import STEPS, TRIGGER_DELAY_US, Frames, World, chosen_exposure, expose
from bench.verdict.causes_truth import sources_digest

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Taken:
    """Recorded frames, and the exposure that they were recorded with."""

    frames: Frames
    exposure: Exposure


def kept_scan(
    keep: Path | None,
    world: World,
    sequence: PatternSequence,
    exposure: Exposure | None = None,
    *,
    number: int = 0,
    response: Response | None = None,
) -> Taken:
    """Return the frames that the instrument records of ``world``, from the folder ``keep`` where they are there, and kept there where not.

    ``exposure``: ``None`` for the one that the instrument's proposals lead to. ``number`` and ``response`` as in ``world.expose``.
    """
    what = (world.scene, world.rig, sequence.period_px, exposure or STEPS, number, TRIGGER_DELAY_US)
    drawn_for = () if response is None else (response.hash,)
    path = None if keep is None else keep / "frames" / f"{world.seed}-{_short(repr(what + drawn_for))}.npz"
    if path is not None and path.exists():
        with np.load(path) as kept:
            taken = Exposure(int(kept["time_us"]), float(kept["gain_db"]))
            return Taken({side: kept[side] for side in SIDES}, taken)
    renderer = world.renderer()
    chosen = exposure or chosen_exposure(renderer, sequence)
    frames = expose(renderer, sequence, chosen, number=number, response=response)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}")
        with draft.open("wb") as file:
            np.savez(file, time_us=chosen.time_us, gain_db=chosen.gain_db, left=frames["left"], right=frames["right"])
        draft.replace(path)
    return Taken(frames, chosen)


def kept_row(keep: Path | None, what: object, find: Callable[[], Row]) -> Row:
    """Return the row that this very product left for ``what`` before, or what ``find`` finds out, which is kept."""
    if keep is None:
        return find()
    path = keep / "rows" / sources_digest()[:12] / f"{_short(repr(what))}.json"
    if path.exists():
        found: Row = json.loads(path.read_text(encoding="utf-8"))
        return found
    row = find()
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}")
    draft.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)
    return row


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:20]
