"""List of the plans: each file of docs/pictures with the function that draws it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from bench.wiring.board import board_plan
from bench.wiring.keys import keys_plan
from bench.wiring.sheet import Sheet
from bench.wiring.system import system_plan

FOLDER = Path(__file__).parents[2] / "docs" / "pictures"
PLANS: Mapping[str, Callable[[], Sheet]] = {
    "wiring-system.svg": system_plan,
    "wiring-board.svg": board_plan,
    "wiring-keys.svg": keys_plan,
}
