"""Frames and rows that this measurement keeps in a folder: rendered once, judged again after each change of the
product.

A frame's name contains all that its image depends on here; a row's name also contains the product's sources. The
simulator's own version is in neither: use an empty folder after changing it.
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
class RecordedFrames:
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
) -> RecordedFrames:
    """Return the frames that the instrument records of ``world``; they are read from and stored in the folder ``keep``.

    ``exposure``: ``None`` for the one that the instrument proposes. ``number`` and ``response`` as in ``world.expose``.
    """
    what = (world.scene, world.rig, sequence.period_px, exposure or STEPS, number, TRIGGER_DELAY_US)
    drawn_for = () if response is None else (response.hash,)
    path = None if keep is None else keep / "frames" / f"{world.seed}-{_short(repr(what + drawn_for))}.npz"
    if path is not None and path.exists():
        with np.load(path) as stored:
            taken_exposure = Exposure(int(stored["time_us"]), float(stored["gain_db"]))
            return RecordedFrames({side: stored[side] for side in SIDES}, taken_exposure)
    renderer = world.renderer()
    chosen = exposure or chosen_exposure(renderer, sequence)
    frames = expose(renderer, sequence, chosen, number=number, response=response)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}")
        with draft.open("wb") as file:
            np.savez(file, time_us=chosen.time_us, gain_db=chosen.gain_db, left=frames["left"], right=frames["right"])
        draft.replace(path)
    return RecordedFrames(frames, chosen)


def kept_row(keep: Path | None, what: object, find: Callable[[], Row]) -> Row:
    """Return the row that this version of the product left for ``what``, or the result of ``find``, which is stored."""
    if keep is None:
        return find()
    path = keep / "rows" / sources_digest()[:12] / f"{_short(repr(what))}.json"
    if path.exists():
        stored: Row = json.loads(path.read_text(encoding="utf-8"))
        return stored
    row = find()
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}")
    draft.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)
    return row


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:20]
