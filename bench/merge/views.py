"""One view of the simulated world for merging: object, rig and pose; frames rendered, and reconstructed as by the
instrument."""

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
class ViewRequest:
    """A view to be taken."""

    object: str
    texture: str
    pose: tuple[float, ...]
    """[x, y, z, rx_deg, ry_deg, rz_deg] of the object in the rig's frame."""
    rig_set: str
    rig_seed: int
    number: int
    """Number of the view, which seeds its noise."""
    size_px: tuple[int, int]


def view_of(request: ViewRequest, keep: Path | None) -> PlacedView:
    """Take a view, or read it from the folder ``keep``, where a new one is stored.

    The calibration states the true rig.
    """
    scene = Scene(object=request.object, pose=_six(request.pose), texture=request.texture, ambient=AMBIENT)
    world = world_of(scene, request.rig_seed, (), truth_set=request.rig_set, size_px=request.size_px)
    stated = stated_truth(world.rig, scene)
    path = (
        None
        if keep is None
        else keep / f"{request.object}-{request.texture}-{request.rig_set}{request.rig_seed}-{request.number}.npz"
    )
    if path is not None and path.exists():
        with np.load(path) as stored:
            cloud = OrganisedCloud(
                stored["points"], stored["sigma"], stored["modulation"], stored["gap"], stored["grey"]
            )
    else:
        frames = expose(world.renderer(), SEQUENCE, EXPOSURE, number=request.number)
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
    R, t = pose_matrix(request.pose)
    place = Rigid(axes, origin).then(Rigid(R.T, -R.T @ t))
    return PlacedView(cloud, place, stated.calibration, stated.water.index)


def _six(pose: tuple[float, ...]) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = pose
    return a, b, c, d, e, f
