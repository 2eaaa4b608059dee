"""Owns what a description, headers and files of numbers tell, before anything that computes is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from appliance.desk.foreign.cameras import ForeignRig, read_rig
from appliance.desk.foreign.description import Description, counted, load_description
from appliance.desk.foreign.images import ImageSet, first_of_side
from appliance.desk.foreign.problem import ForeignError


def look_first(path: Path) -> tuple[Description, Mapping[str, ImageSet]]:
    """Check all of a description that takes no time: its words, that its images are there, and the cameras' numbers.
    Raises ForeignError.

    Returns the description and, by side, what the images show with the first of them (``first_of_side``).
    """
    said = load_description(path)
    return checked(path, said, {side: first_of_side(said, side) for side in said.files})[:2]


def checked(
    path: Path, said: Description, sets: Mapping[str, ImageSet]
) -> tuple[Description, Mapping[str, ImageSet], ForeignRig]:
    """Return the description with its images counted, the images, and the cameras that took them.

    Raises ForeignError where they do not belong together.
    """
    description = counted(said, sets["left"].shown)
    if "right" in sets and set(sets["right"].shown) != set(sets["left"].shown):
        raise ForeignError(f"{path}: left and right have other images; name the same for both")
    sizes_px = {side: (one.shape[1], one.shape[0]) for side, one in sets.items()}
    sizes_px.setdefault("right", description.projector_px)
    return description, sets, read_rig(description, sizes_px)
