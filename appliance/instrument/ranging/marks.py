"""Owns where the laser dots are going to be seen in the live pictures: marks for the diver to aim at what is to be
measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.instrument.ranging.beams import PointerBeam
from appliance.instrument.ranging.rig_frame import RigFrame
from appliance.measure import StereoRig

Place = tuple[float, float]
"""Position in shares of a picture's width and height, from its upper left corner."""


@dataclass(frozen=True, slots=True)
class Track:
    """Track of one pointer's dot in one picture: at the near end, in the middle, and at the far end of the volume."""

    near: Place
    middle: Place
    far: Place


@dataclass(frozen=True, slots=True)
class Marks:
    """The tracks in each camera's picture; a pointer whose dot would lie beside the picture has none."""

    left: tuple[Track, ...]
    right: tuple[Track, ...]


def marks_of(rig: StereoRig, frame: RigFrame, water_index: float, beams: tuple[PointerBeam, PointerBeam]) -> Marks:
    """Return the marks for beams as they are known now, by the calibration in use, through the windows and the
    water."""
    z_mm = np.array([rig.volume.nearest_mm, rig.volume.working_mm, rig.volume.farthest_mm])
    sides = []
    for camera in (rig.left, rig.right):
        tracks = []
        for beam in beams:
            shares = (camera.project(frame.to_left(beam.at(z_mm)), water_index) + 0.5) / (
                camera.width_px,
                camera.height_px,
            )
            if np.isfinite(shares).all() and (shares > 0.0).all() and (shares < 1.0).all():
                tracks.append(Track(*((float(u), float(v)) for u, v in shares)))
        sides.append(tuple(tracks))
    return Marks(sides[0], sides[1])
