"""File of a measurement of the world ``outside``: results of each part, by seed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.result import Measurement

Content = Mapping[str, Any]


def read(path: Path) -> dict[str, Any]:
    """Return the content of a file: results of each part, by seed. Raises OSError, and ValueError for another file."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    parts = content.get("parts") if isinstance(content, dict) else None
    seeds = [seed for part in parts.values() for seed in part] if isinstance(parts, dict) else []
    if not isinstance(parts, dict) or not all(seed.isdigit() for seed in seeds):
        raise ValueError(
            f"{path}: no measurement by parts and seeds; allowed: files of ./dev bench outside --json. Name another file"
        )
    return content


def added(content: Content, name: str, seed: int, measured: Sequence[Measurement], part: Content) -> dict[str, Any]:
    """Return the content with the figures of a part and a seed in place of former ones.

    ``part`` has the other values: ``count``, ``noise``, ``measured_on`` and ``data``, JSON-ready.
    """
    mine = {**part, "measured": [figure.as_dict() for figure in measured]}
    seeds = {**content["parts"].get(name, {}), str(seed): mine}
    return {**content, "parts": {**content["parts"], name: seeds}}
