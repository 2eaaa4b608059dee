"""Owns what makes a recorded fringe no pure sine: each cause can be switched off, so that its effect can be measured."""

from __future__ import annotations

from dataclasses import dataclass

RESPONSES = ("measured", "linear", "gamma")


@dataclass(frozen=True, slots=True)
class Imaging:
    """Projector and lenses. Raises ValueError for a response that is not one of ``RESPONSES``."""

    response: str = "measured"
    """Light of the projector's codes: like one that was measured, proportional, or a pure gamma of 2.2."""
    projector_defocus: bool = True
    """Light gets softer away from the projector's focus."""
    camera_defocus: bool = False
    """Images get softer away from the cameras' focus: at f/8 by 0.46 px (of 1600) where ``FAR_MM`` away, which is added in
    squares to the lens's own blur. Off, because it costs time and, inside of the measuring volume, next to nothing."""

    def __post_init__(self) -> None:
        if self.response not in RESPONSES:
            raise ValueError(f"response '{self.response}'; allowed are {', '.join(RESPONSES)}")
