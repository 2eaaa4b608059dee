"""The trigger board: one serial line of readable, numbered and checked sentences."""

from drivers.board.board import BoardSpec, TriggerBoard

__all__ = ["BoardSpec", "TriggerBoard"]
