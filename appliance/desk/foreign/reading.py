"""Owns the way from a description to decoded cameras whose conventions were tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.base import Progress
from appliance.desk.foreign.arrangement import examine_cameras
from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome, examine_axis, examine_references
from appliance.desk.foreign.camera import CleanCamera, DecodedCamera, clean_camera, decode_camera
from appliance.desk.foreign.cameras import ForeignRig
from appliance.desk.foreign.description import Description, load_description
from appliance.desk.foreign.first_look import checked
from appliance.desk.foreign.images import read_side


@dataclass(frozen=True, slots=True, eq=False)
class ForeignScan:
    """A foreign set that was read and decoded, and what its images say of its description."""

    description: Description
    rig: ForeignRig
    cameras: Mapping[str, CleanCamera]
    """``left`` and, unless a projector takes its place, ``right``."""
    tested: tuple[ExaminedAssumption, ...]

    @property
    def wrong(self) -> tuple[ExaminedAssumption, ...]:
        """Assumptions that the images contradict."""
        return tuple(one for one in self.tested if one.outcome is Outcome.WRONG)


def read_foreign(path: Path, progress: Progress) -> ForeignScan:
    """Read what the description at ``path`` describes, decode it and test it. Raises ForeignError."""
    said = load_description(path)
    read = {}
    for side in said.files:
        progress(f"reading {side}")
        read[side] = read_side(said, side)
    description, sets, rig = checked(path, said, read)
    cameras, tested = {}, list[ExaminedAssumption]()
    for side, images in sets.items():
        progress(f"decoding {side}")
        cameras[side] = decode_camera(images, description)
        tested += _by_images(side, cameras[side], description)
        if len(sets) > 1:
            # Beside a projector other conventions are tried on the phases; those of two cameras would need much room.
            cameras[side] = replace(cameras[side], measured={})
    progress("testing the description")
    said_of_all = _by_rays(description, cameras, rig, tested)
    # One after the other: what was decoded of a large set needs as much room again.
    cleaned = {side: clean_camera(cameras.pop(side)) for side in sets}
    return ForeignScan(description, rig, cleaned, said_of_all)


def examine(
    description: Description, cameras: Mapping[str, DecodedCamera], rig: ForeignRig | None
) -> tuple[ExaminedAssumption, ...]:
    """Test all that is said of decoded images, and of ``rig`` where it is known; images may be thinned by a whole
    number.

    A word that one test leaves open does not fit because of another one.
    """
    tested = [one for side, camera in cameras.items() for one in _by_images(side, camera, description)]
    return _by_rays(description, cameras, rig, tested)


def _by_images(side: str, camera: DecodedCamera, description: Description) -> list[ExaminedAssumption]:
    found = examine_references(camera)
    for axis in description.axes:
        found += examine_axis(camera, axis)
    return [replace(one, about=f"{side}: {one.about}") for one in found]


def _by_rays(
    description: Description,
    cameras: Mapping[str, DecodedCamera],
    rig: ForeignRig | None,
    tested: list[ExaminedAssumption],
) -> tuple[ExaminedAssumption, ...]:
    """Return what the images say of themselves, ``tested``, and what rays say of the cameras."""
    if any(one.outcome is Outcome.WRONG for one in tested):
        # Of coordinates that are wrong, nothing could be told about the cameras.
        tested.append(ExaminedAssumption("cameras", Outcome.UNCHECKED, "what the images show is described wrongly"))
    elif rig is not None:
        tested += examine_cameras(description, rig, cameras)
    open_ = {one.about.split(": ")[-1] for one in tested if one.outcome is not Outcome.FITS}
    return tuple(one for one in tested if one.outcome is not Outcome.FITS or one.about.split(": ")[-1] not in open_)
