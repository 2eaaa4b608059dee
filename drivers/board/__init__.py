"""The trigger board: one serial line of readable, numbered and checked sentences."""

from drivers.board.board import TriggerBoard
from drivers.board.spec import BoardSpec

__all__ = ["BoardSpec", "TriggerBoard"]
