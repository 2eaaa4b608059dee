"""The parameters of a rig that a calibration may change, as increments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.rotation import matrix3, rotation_matrix

Array = NDArray[np.float64]

_PORT = ("port tilt x (rad)", "port tilt y (rad)", "interface distance (mm)")
_LENS = ("principal distance (px)", "principal point u (px)", "principal point v (px)", "k1", "k2", "p1", "p2", "k3")
_POSE = ("turn x (rad)", "turn y (rad)", "turn z (rad)", "shift x (mm)", "shift y (mm)", "shift z (mm)")


@dataclass(frozen=True, slots=True, eq=False)
class RigParameters:
    """The parameters of a rig: six of the ports, then the twenty-two that are calibrated in air."""

    names: tuple[str, ...]
    steps: Array
    """(n,): increments for difference quotients: hundredths of a pixel at the image's edge, in the linear range."""
    ports = slice(0, 6)
    air = slice(6, 28)

    @property
    def count(self) -> int:
        """Number of all parameters."""
        return len(self.names)

    def changed(self, rig: StereoRig, x: Array | float, which: slice | int | Sequence[int] = slice(None)) -> StereoRig:
        """Return ``rig`` changed by increments ``x`` of the parameters ``which``, in the order of ``names``.

        Tilts are of the port's normal towards the camera's x and y; rotations are about the right camera's axes.
        """
        full = np.zeros(self.count)
        full[which] = x
        turned = np.asarray(rig.right.rotation) @ rotation_matrix(full[22:25])
        shifted = np.asarray(rig.right.translation_mm) + full[25:28]
        right = _camera_with(rig.right, full[3:6], full[14:22])
        return replace(
            rig,
            left=_camera_with(rig.left, full[0:3], full[6:14]),
            right=replace(right, rotation=matrix3(turned), translation_mm=_triple(shifted)),
        )


RIG_PARAMETERS = RigParameters(
    (
        *(f"{side} {name}" for side in ("left", "right") for name in _PORT),
        *(f"{side} {name}" for side in ("left", "right") for name in _LENS),
        *(f"right camera's {name}" for name in _POSE),
    ),
    np.array([1e-5, 1e-5, 1e-3] * 2 + [1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-6, 1e-6, 1e-5] * 2 + [1e-6] * 3 + [1e-3] * 3),
)


def _camera_with(camera: HousedCamera, port: Array, lens: Array) -> HousedCamera:
    n = np.asarray(camera.port.normal)
    across = np.array([n[2], 0.0, -n[0]])
    across /= np.linalg.norm(across)
    leaned = n + math.tan(port[0]) * across + math.tan(port[1]) * np.cross(n, across)
    leaned /= np.linalg.norm(leaned)
    old = camera.lens
    scale = (old.f_px[0] + lens[0]) / old.f_px[0]
    k1, k2, p1, p2, k3 = (float(a + b) for a, b in zip(old.distortion, lens[3:8], strict=True))
    return replace(
        camera,
        lens=Lens(
            (float(old.f_px[0] * scale), float(old.f_px[1] * scale)),
            (float(old.c_px[0] + lens[1]), float(old.c_px[1] + lens[2])),
            (k1, k2, p1, p2, k3),
        ),
        port=Port(
            _triple(leaned), float(camera.port.distance_mm + port[2]), camera.port.thickness_mm, camera.port.glass_index
        ),
    )


def _triple(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
