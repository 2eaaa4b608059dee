"""Owns one view of the simulated world for merging: an object, a rig, a place; frames rendered and reconstructed as the instrument does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.exposure import Exposure
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud, organised
from appliance.measure.points.pipeline import Pipeline
from bench.outside.scan import SEQUENCE, data_sheet
from bench.outside.stated import stated_truth
from bench.outside.world import expose, world_of
from hw_sim.objects.motion import pose_matrix
from hw_sim.scene import Scene
from tests.support.truth import left_to_rig

EXPOSURE = Exposure(12_000)
AMBIENT = 0.01
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedView:
    """A view, and where it was taken from."""

    cloud: OrganisedCloud
    place: Rigid
    """From the left camera's frame into the object's."""
    calibration: Calibration
    water_index: float


@dataclass(frozen=True, slots=True)
class Wanted:
    """A view to be taken."""

    object: str
    texture: str
    pose: tuple[float, ...]
    """[x, y, z, rx_deg, ry_deg, rz_deg] of the object in the rig's frame."""
    rig_set: str
    rig_seed: int
    number: int
    """Makes its noise its own."""
    size_px: tuple[int, int]


def view_of(wanted: Wanted, keep: Path | None) -> PlacedView:
    """Take a view, or read it from the folder ``keep``, where it is left otherwise. The calibration states the truth about the rig."""
    scene = Scene(object=wanted.object, pose=_six(wanted.pose), texture=wanted.texture, ambient=AMBIENT)
    world = world_of(scene, wanted.rig_seed, (), truth_set=wanted.rig_set, size_px=wanted.size_px)
    stated = stated_truth(world.rig, scene)
    path = (
        None
        if keep is None
        else keep / f"{wanted.object}-{wanted.texture}-{wanted.rig_set}{wanted.rig_seed}-{wanted.number}.npz"
    )
    if path is not None and path.exists():
        with np.load(path) as kept:
            cloud = OrganisedCloud(kept["points"], kept["sigma"], kept["modulation"], kept["gap"], kept["grey"])
    else:
        frames = expose(world.renderer(), SEQUENCE, EXPOSURE, number=wanted.number)
        with Pipeline(stated.calibration, stated.water, SEQUENCE, noise=data_sheet(scene, 0.0)) as pipeline:
            for side, stack in frames.items():
                for k in range(len(stack)):
                    pipeline.push(side, stack, k)
            pipeline.coarse()
            cloud = organised(pipeline.full(), frames["left"][SEQUENCE.bright])
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            draft = path.with_name(f".{path.name}")
            with draft.open("wb") as file:
                np.savez(
                    file, points=cloud.points_mm, sigma=cloud.sigma_mm, modulation=cloud.modulation_dn,
                    gap=cloud.ray_gap_mm, grey=cloud.grey,
                )  # fmt: skip
            draft.replace(path)
    origin = left_to_rig(world.rig, np.zeros((1, 3)))[0]
    axes = (left_to_rig(world.rig, np.eye(3)) - origin).T
    R, t = pose_matrix(wanted.pose)
    place = Rigid(axes, origin).then(Rigid(R.T, -R.T @ t))
    return PlacedView(cloud, place, stated.calibration, stated.water.index)


def _six(pose: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = pose
    return a, b, c, d, e, f
