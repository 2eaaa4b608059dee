"""Possible changes of an instrument between two calibrations, and their length errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.water.artefact import triangulate
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import Water
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.truth import TrueEye, TrueRig, project
from tests.support.calibrating import Pose
from tests.support.truth import WATER

BAR_MM = 150.0
POSES = (
    Pose((0.0, 0.0, 500.0), (0.0, 0.0, 0.0)),
    Pose((0.0, 0.0, 500.0), (0.0, 0.0, 90.0)),
    Pose((0.0, 0.0, 500.0), (0.0, 0.0, 40.0)),
    Pose((0.0, 0.0, 520.0), (0.0, 40.0, 0.0)),
    Pose((0.0, 0.0, 520.0), (0.0, -40.0, 0.0)),
    Pose((20.0, 10.0, 470.0), (0.0, 20.0, 60.0)),
    Pose((-20.0, -10.0, 560.0), (0.0, -20.0, -60.0)),
)
"""Of a ball bar: along, across, oblique, in depth, near and far."""


@dataclass(frozen=True, slots=True)
class Change:
    """One possible change; ``make`` returns the instrument after a change of ``size``."""

    name: str
    unit: str
    size: float
    """A small size, from which the effect of others follows in proportion."""
    largest: float
    """Largest tested size."""
    make: Callable[[TrueRig, float], TrueRig]


def changes() -> list[Change]:
    """Return all changes, in the order of the table."""
    all_changes = []
    for camera in ("right", "left"):
        for axis, axis_name in (("pitch", "x"), ("yaw", "y"), ("roll", "z")):
            all_changes.append(
                Change(
                    f"{camera} camera turned about {axis_name} ({axis})", "°", 0.02, 2.0, _knock(camera, f"{axis}_deg")
                )
            )
    all_changes.append(Change("cameras turned about y against each other (toe-in)", "°", 0.02, 2.0, _toe_in))
    all_changes += [
        Change(f"right camera shifted along {axis}", "mm", 0.05, 10.0, _knock("right", f"{axis}_mm")) for axis in "xyz"
    ]
    for sides, name in ((("right",), "right"), (("left", "right"), "both")):
        all_changes.append(Change(f"principal distance, {name}", "1e-4", 1.0, 100.0, _eyes(sides, _longer)))
        all_changes.append(Change(f"interface distance, {name}", "mm", 0.1, 10.0, _eyes(sides, _deeper)))
    all_changes.append(Change("right port tilted about y", "°", 0.05, 5.0, _eyes(("right",), _tilted(0))))
    all_changes.append(Change("right port tilted about x", "°", 0.05, 5.0, _eyes(("right",), _tilted(1))))
    all_changes.append(Change("water saltier than stated", "psu", 2.0, 45.0, _salt))
    all_changes.append(Change("water warmer than stated", "K", 5.0, 20.0, _warm))
    all_changes.append(Change("water colder than stated", "K", 5.0, 20.0, _cold))
    return all_changes


def length_error_percent(truth: TrueRig, changed: TrueRig, rig: StereoRig) -> float:
    """Return the largest change of a ball bar's measured length, percent, over ``POSES``; without noise."""
    worst = 0.0
    for pose in POSES:
        ends = pose.rotation @ np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]).T * BAR_MM
        points = ends.T + pose.at_mm
        before, after = (_length(true_rig, points, rig) for true_rig in (truth, changed))
        worst = max(worst, abs(after - before) / BAR_MM)
    return 100.0 * worst


def _length(truth: TrueRig, points_mm: NDArray[np.float64], rig: StereoRig) -> float:
    pixels = [project(truth, side, points_mm) for side in ("left", "right")]
    a, b = triangulate(rig, pixels[0], pixels[1], WATER.index)
    return float(np.linalg.norm(b - a))


def _knock(camera: str, amount: str) -> Callable[[TrueRig, float], TrueRig]:
    return lambda truth, size: with_mount_shifted(truth, MountShift(camera, **{amount: size}))


def _toe_in(truth: TrueRig, size: float) -> TrueRig:
    return with_mount_shifted(
        with_mount_shifted(truth, MountShift("left", yaw_deg=size)), MountShift("right", yaw_deg=-size)
    )


def _eyes(sides: tuple[str, ...], make: Callable[[TrueEye, float], TrueEye]) -> Callable[[TrueRig, float], TrueRig]:
    def changed(truth: TrueRig, size: float) -> TrueRig:
        left, right = (make(truth.eye(s), size) if s in sides else truth.eye(s) for s in ("left", "right"))
        return replace(truth, left=left, right=right)

    return changed


def _longer(eye: TrueEye, size: float) -> TrueEye:
    factor = 1.0 + 1e-4 * size
    return replace(eye, f_px=(eye.f_px[0] * factor, eye.f_px[1] * factor))


def _deeper(eye: TrueEye, size: float) -> TrueEye:
    return replace(eye, port=replace(eye.port, d_mm=eye.port.d_mm + size))


def _tilted(axis: int) -> Callable[[TrueEye, float], TrueEye]:
    def tilt(eye: TrueEye, size: float) -> TrueEye:
        normal = np.array(eye.port.normal)
        normal[axis] += np.tan(np.radians(size))
        normal /= np.linalg.norm(normal)
        return replace(eye, port=replace(eye.port, normal=(float(normal[0]), float(normal[1]), float(normal[2]))))

    return tilt


def _salt(truth: TrueRig, size: float) -> TrueRig:
    return replace(truth, n_water=Water(20.0, size, 530.0).index)


def _warm(truth: TrueRig, size: float) -> TrueRig:
    return replace(truth, n_water=Water(20.0 + size, 0.0, 530.0).index)


def _cold(truth: TrueRig, size: float) -> TrueRig:
    return replace(truth, n_water=Water(20.0 - size, 0.0, 530.0).index)
