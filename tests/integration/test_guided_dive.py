"""A diver who goes where the screen points: between scans no pose is planned, only a first nudge along the pipe."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.machine.words import english
from appliance.scan.guidance import LEAST_GOOD, MOST_GOOD
from appliance.screens.painter import Painter
from appliance.screens.views import AimView, AnyView, ReviewView
from appliance.service.app import run
from appliance.storage.library import Library
from hw_sim.people import script
from hw_sim.people.follower import follow
from hw_sim.people.operator import Operator
from hw_sim.world import true_rig
from tests.integration.test_many_scans_in_the_water import BEGIN, in_the_object
from tests.support.truth import left_to_rig

pytestmark = pytest.mark.dive

STEP_MM = 30
ALIKE = 0.1
"""What was said while aiming, against what the scan has in common then: hands have not moved."""
SCRIPT = f"""
{BEGIN}
object main 250 3 553 1 -2 1
pause 0.3
press scan
wait state REVIEW 90
press scan
wait scans 1 60
wait state AIM 60
object main 215 -4 549 -2 1 3     # a first nudge, and another grip
follow {STEP_MM} 60               # too much in common: farther along
press scan
wait state REVIEW 90
wait overlap OVERLAP* 60
press scan
wait scans 2 60
wait state AIM 60
object main -55 2 556 2 2 -2        # carried along by the current: too far
follow {STEP_MM} 60               # back
press scan
wait state REVIEW 90
wait overlap OVERLAP* 60
press scan
wait scans 3 60
wait state AIM 60
end
"""


def test_who_follows_the_arrow_takes_scans_that_overlap_by_half(tmp_path: Path) -> None:
    (tmp_path / "dive.script").write_text(SCRIPT)
    options = SimOptions(
        root=tmp_path / "root", object_name="main", texture="slight", truth="nominal", seed=3, size="400x300",
        script=tmp_path / "dive.script",
    )  # fmt: skip
    rig = simulated(load_rig(default_sim_rig()), options)
    aimed: list[str] = []
    reviewed: list[str] = []
    followed: list[tuple[float, ...]] = []
    draw = Painter.draw

    def drawn(painter: Painter, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        if isinstance(view, AimView) and view.guidance is not None:
            aimed.append(view.guidance.whole)
        elif isinstance(view, ReviewView) and view.overlap is not None:
            reviewed.append(english(view.overlap.words))
        return draw(painter, view, time_s)

    def seen(diver: Operator, step_mm: float, timeout_s: float) -> bool:
        arrived = follow(diver, step_mm, timeout_s)
        followed.append(diver.world.scene.pose or ())
        return arrived

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Painter, "draw", drawn)
        patch.setattr(script, "follow", seen)
        assert run(rig) == 0
    scans = Library(rig.storage.root)
    poses = [(250.0, 3.0, 553.0, 1.0, -2.0, 1.0), *followed]
    assert len(scans.ids()) == len(poses) == 3
    # The main lies along x: on means to its smaller x, back to its larger.
    assert poses[1][0] < 200.0
    assert poses[2][0] > -55.0, poses
    truth = true_rig(rig.rig.wires_options)
    clouds = []
    for scan, pose in zip(scans.ids(), poses, strict=True):
        cloud = scans.load(scan).cloud()
        assert cloud is not None
        clouds.append(in_the_object(left_to_rig(truth, cloud.points_mm), pose))
    for before, after in pairwise(clouds):
        distance, _ = cKDTree(before).query(after[::20], distance_upper_bound=3.0)
        assert LEAST_GOOD - ALIKE < np.isfinite(distance).mean() < MOST_GOOD + ALIKE
    moves = [words.split(": ")[-1] for words in dict.fromkeys(aimed)]
    assert {"GO ON", "GO BACK", "SCAN NOW"} <= set(moves)
    assert len(dict.fromkeys(reviewed)) == 2, "and after each scan the overlap that it has"
