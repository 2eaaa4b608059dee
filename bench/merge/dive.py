"""A dive of hand-held scans along the water main, stored as by the instrument, and one object made of them.

Each scan is rendered at rest; ``object solve`` reads its raw frames and does all else.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from appliance.cli.main import main
from appliance.desk import object_store as objects
from appliance.measure.calibration.file import encode_calibration
from appliance.measure.overlap.rigid import Rigid
from bench.merge.row import poses_along
from bench.merge.views import AMBIENT, EXPOSURE
from bench.outside.scan import SEQUENCE
from bench.outside.stated import stated_truth
from bench.outside.world import expose, world_of
from bench.result import Measurement
from bench.spread import spread
from hw_sim.objects.motion import pose_matrix
from hw_sim.scene import Scene
from tests.support.rendered import RenderedScan
from tests.support.stored import store
from tests.support.truth import left_to_rig

SCANS = 14
RIG_SET = "realistic"
NAME, FILES, PAGE = "pipe", ("object.e57", "object.stl"), "report.html"
MOST_SIGMAS = 3.0


def measure(seed: int, size_px: tuple[int, int], keep: Path | None) -> list[Measurement]:
    """Return how many scans have a pose, the largest error, and the cost of one call. Its files stay in ``keep``."""
    poses = poses_along(seed, SCANS, 0)
    with tempfile.TemporaryDirectory() as temporary:
        root = keep or Path(temporary)
        (root / "scans").mkdir(parents=True, exist_ok=True)
        list(spread(partial(_stored, root=root, seed=seed, size_px=size_px), list(enumerate(poses, 1))))
        scene = _scene(poses[0])
        rig = world_of(scene, seed, (), truth_set=RIG_SET, size_px=size_px).rig
        calibration = root / "calibration.json"
        calibration.write_bytes(encode_calibration(stated_truth(rig, scene).calibration))
        names = [f"{number:06}" for number in range(1, SCANS + 1)]
        name = NAME if not (root / "objects" / NAME).exists() else f"{NAME} {len(objects.object_names(root)) + 1}"
        arguments = ["object", "solve", name, *names, "--root", str(root), "--calibration", str(calibration)]
        arguments.append("--foreign-calibration")
        files = [word for file in FILES for word in ("--out", str(root / file))]
        begun = time.process_time()
        with contextlib.redirect_stdout(io.StringIO()):
            code = int(main(arguments))
            of_object = (f"object:{name}", *arguments[3 + len(names) :])
            main(["cloud", *of_object, *files])
            main(["report", *of_object, "--out", str(root / PAGE)])
        spent = time.process_time() - begun
        return [
            Measurement("dive: exit code", code, "", at_most=0.0),
            *judge_dive(root, name, seed, size_px),
            Measurement("dive: CPU of one call, raw frames to files", spent, "s"),
            *(
                Measurement(f"dive: {file}", (root / file).stat().st_size / 1e6, "MB")
                for file in (*FILES, PAGE)
                if (root / file).exists()
            ),
        ]


def judge_dive(root: Path, name: str, seed: int, size_px: tuple[int, int]) -> list[Measurement]:
    """Return how many scans of the object have a pose, and their errors."""
    places = objects.read_object(root, name).places
    if places is None:
        return [Measurement("dive: scans placed by one call", 0.0, f"of {SCANS}", at_least=SCANS)]
    poses = poses_along(seed, SCANS, 0)
    rig = world_of(_scene(poses[0]), seed, (), truth_set=RIG_SET, size_px=size_px).rig
    origin = left_to_rig(rig, np.zeros((1, 3)))[0]
    axes = Rigid((left_to_rig(rig, np.eye(3)) - origin).T, origin)

    def true_of(scan: str) -> Rigid:
        R, t = pose_matrix(poses[int(scan) - 1])
        return axes.then(Rigid(R.T, -R.T @ t))

    names = list(places.places)
    frame = true_of(names[0]).inverse
    off_mm, apart_mm = [], []
    for scan, place in places.places.items():
        middle_mm = np.array(place.middle_mm)
        mine = Rigid(np.array(place.rotation), np.array(place.translation_mm)).inverse.of(middle_mm)
        off_mm.append(float(np.linalg.norm(middle_mm - true_of(scan).then(frame).of(mine))))
        apart_mm.append(float(np.linalg.norm(middle_mm - np.array(places.places[names[0]].middle_mm))))
    sigma_mm = [place.sigma_mm for place in places.places.values()]
    own_mm = [
        float(np.sqrt(max(scan_pose.sigma_mm**2 - scan_pose.bending_mm**2, 0.0)))
        for scan_pose in places.places.values()
    ]
    farthest = int(np.argmax(apart_mm))
    return [
        Measurement("dive: scans placed by one call", len(names), f"of {SCANS}", at_least=SCANS),
        Measurement("dive: farthest scan's way from the first", apart_mm[farthest], "mm"),
        Measurement("dive: farthest scan off", 1000.0 * off_mm[farthest], "um"),
        Measurement("dive: stated of it, with what may bend it", 1000.0 * sigma_mm[farthest], "um"),
        Measurement("dive: stated of it by the pairs alone", 1000.0 * own_mm[farthest], "um"),
        Measurement(
            "dive: largest error over stated",
            max((off / sigma for off, sigma in zip(off_mm[1:], sigma_mm[1:], strict=True)), default=float("nan")),
            "standard deviations",
            at_most=MOST_SIGMAS,
        ),
    ]


def _scene(pose: tuple[float, ...]) -> Scene:
    a, b, c, d, e, f = pose
    return Scene(object="main", pose=(a, b, c, d, e, f), texture="slight", ambient=AMBIENT)


def _stored(item: tuple[int, tuple[float, ...]], root: Path, seed: int, size_px: tuple[int, int]) -> None:
    number, pose = item
    folder = root / "scans" / f"{number:06}"
    if folder.exists():
        return
    world = world_of(_scene(pose), seed, (), truth_set=RIG_SET, size_px=size_px)
    renderer = world.renderer()
    frames = expose(renderer, SEQUENCE, EXPOSURE, number=number)
    store(RenderedScan(renderer, SEQUENCE, frames), folder, exposure_ms=EXPOSURE.time_us / 1000.0)
