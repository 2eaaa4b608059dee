"""The signed ray gap, and its response to changes of the calibration.

The two rays of a true correspondence meet if the calibration is right. If it is wrong, they pass each other, mostly up
or down in the image: the gap is the only quantity of a scan of an unknown object that must be zero. It is positive
where the left ray is below the right one (+y of the left camera frame).

Changes can be distinguished only as far as their patterns of gaps over the image differ. Four patterns explain nearly
all changes by mechanics and water (``docs/calibration-health.md``); each is the response of the model to a change of
the right camera, orthogonal to the earlier ones:

    height   rotation about x: both ends of the image alike
    twist    rotation about z: opposite at left and right
    scale    principal distance: opposite at top and bottom
    shear    rotation about y: opposite at neighbouring corners
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.light.model import StereoRig

Array = NDArray[np.float64]

MODES = ("height", "twist", "scale", "shear")
_PRIMARIES = (
    "right camera's turn x (rad)",
    "right camera's turn z (rad)",
    "right principal distance (px)",
    "right camera's turn y (rad)",
)
TURNS = tuple(f"right camera's turn {axis} (rad)" for axis in "xyz")
FIELD_NODES = (12, 9)
FIELD_DEPTHS_MM = (460.0, 525.0, 590.0)
"""Depths, of the standard housing, of the lattice in the working volume on which amplitudes are normalised."""


@dataclass(frozen=True, slots=True)
class VeilGaps:
    """Ray gaps in µm by backscatter fringes at n places of the left image."""

    left_px: Array
    """(n, 2)."""
    gap_um: Array
    """(n,) expected gap."""
    doubts_um: Array
    """(n, DOUBTS) its errors by one standard deviation of each cause; each is common to all places."""
    shape_um: Array
    """(n,) standard deviation of its remaining error, smooth over the image."""


def signed_gap_mm(rig: StereoRig, water_index: float, left_px: Array, right_px: Array) -> Array:
    """Return the gaps (n,) in mm of matched pixels (n, 2) of both cameras."""
    return _gap(*rig.left.rays(left_px, water_index), *rig.right.rays(right_px, water_index))


def pairs_in_volume(rig: StereoRig, water_index: float) -> tuple[Array, Array]:
    """Return matched pixels (n, 2) of both cameras, spread over the working volume."""
    left, right = rig.left, rig.right
    share = [np.linspace(0.03, 0.97, nodes) for nodes in FIELD_NODES]
    u, v = np.meshgrid(share[0] * (left.width_px - 1), share[1] * (left.height_px - 1))
    uv = np.stack([u, v], -1).reshape(-1, 2)
    origin, direction = left.rays(uv, water_index)
    pairs = []
    for depth_mm in (rig.volume.scaled(mm) for mm in FIELD_DEPTHS_MM):
        points = origin + direction * ((depth_mm - origin[:, 2:]) / direction[:, 2:])
        right_px = right.project(points, water_index)
        with np.errstate(invalid="ignore"):
            inside = np.all((right_px >= 0.0) & (right_px <= [right.width_px - 1, right.height_px - 1]), axis=1)
        pairs.append((uv[inside], right_px[inside]))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


class GapModes:
    """The four patterns of one calibration in one water. Amplitudes are µm RMS over the working volume.

    Raises ValueError if the cameras share too little of the volume to distinguish the patterns.
    """

    def __init__(self, rig: StereoRig, water_index: float) -> None:
        self._rig = rig
        self.water_index = water_index
        self.size_px = (rig.left.width_px, rig.left.height_px)
        self.volume = rig.volume
        self.field_px = pairs_in_volume(rig, water_index)
        """Matched pixels, (n, 2) of each camera, over which amplitudes are normalised."""
        if len(self.field_px[0]) < 4 * len(MODES):
            raise ValueError("the cameras share too little of the measuring volume; check the relative orientation")
        steps = [RIG_PARAMETERS.names.index(name) for name in _PRIMARIES]
        self._changed = [RIG_PARAMETERS.changed(rig, RIG_PARAMETERS.steps[k], k) for k in steps]
        self._mix = np.eye(len(MODES))
        raw = self.at(*self.field_px)
        r = np.linalg.qr(raw / np.sqrt(len(raw)), mode="r")
        signs = np.sign(np.diag(r))
        if not np.abs(np.diag(r)).min() >= 1e-9:  # NaN neither
            raise ValueError("two gap patterns of this calibration are the same; check the relative orientation")
        self._mix = np.linalg.inv(r) * signs
        # The amplitudes of a change are its column of R, in mm for one step.
        of_step = 1000.0 * signs[:, None] * r
        per_deg = {
            name: np.radians(of_step[:, k] / RIG_PARAMETERS.steps[steps[k]]) for k, name in enumerate(_PRIMARIES)
        }
        self.turns_um = np.stack([per_deg[name] for name in TURNS])
        """Amplitudes (3, 4) per degree that the right camera is turned by, about x, y, z."""

    def at(self, left_px: Array, right_px: Array) -> Array:
        """Return the patterns (n, 4) at matched pixels (n, 2): µm of gap per µm of amplitude."""
        p, a = self._rig.left.rays(left_px, self.water_index)
        base = _gap(p, a, *self._rig.right.rays(right_px, self.water_index))
        columns = [_gap(p, a, *rig.right.rays(right_px, self.water_index)) - base for rig in self._changed]
        return np.asarray(np.stack(columns, -1) @ self._mix)


def in_words(parameter: str, change: float) -> str:
    """Return a rotation of the right camera in a technician's words."""
    return f"the right camera turned by {np.degrees(change):+.3f}° about its {parameter.split()[3]} axis"


def _gap(p: Array, a: Array, q: Array, b: Array) -> Array:
    across = np.cross(a, b)
    across *= np.sign(across[..., 1:2])
    return np.asarray(np.sum((p - q) * across, -1) / np.linalg.norm(across, axis=-1))
