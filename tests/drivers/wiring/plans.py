"""Owns the list of the plans: which file of docs/pictures is drawn by what."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tests.drivers.wiring.board import board_plan
from tests.drivers.wiring.keys import keys_plan
from tests.drivers.wiring.sheet import Sheet
from tests.drivers.wiring.system import system_plan

FOLDER = Path(__file__).parents[3] / "docs" / "pictures"
PLANS: Mapping[str, Callable[[], Sheet]] = {
    "wiring-system.svg": system_plan,
    "wiring-board.svg": board_plan,
    "wiring-keys.svg": keys_plan,
}
