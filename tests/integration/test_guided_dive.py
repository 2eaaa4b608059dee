"""A diver who goes where the screen points along a metre of pipe, once too far: scans overlap by half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.instrument.machine.words import worded
from appliance.instrument.screens.painter import Painter
from appliance.instrument.screens.views import AimView, AnyView, MenuView, ReviewView
from appliance.instrument.service.app import run
from appliance.instrument.service.devices import KeyReader
from appliance.measure.guidance import LEAST_GOOD, MOST_GOOD
from appliance.store.config import Rig
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import read
from drivers.api import KeyEvent, KeyPress
from hw_sim.objects.motion import pose_matrix
from hw_sim.people import script
from hw_sim.people.follower import follow
from hw_sim.people.operator import Operator
from hw_sim.world import true_rig
from tests.integration.dived import instrument
from tests.support.truth import left_to_rig

Array = NDArray[np.float64]

STEP_MM = 30
ALIKE = 0.1
"""What was said while aiming, against what the scan has in common then: hands have not moved."""
CPU_S = 0.5
"""Of the overlap, as the worker measures it itself."""
MOST_PICTURES = 2
"""From a press to its answer: at 60 Hz a third of the 100 ms that a diver may wait."""
FIRST = (250.0, 3.0, 553.0, 1.0, -2.0, 1.0)
SCRIPT = f"""
wait state AIM 120
press back                # UNCALIBRATED: seen
pause 0.5
press up
wait state MENU 5
press down
press down
press down
press down
press scan
press up                  # 1 NEW
press scan
press back
wait state AIM 5
object main {" ".join(f"{value:g}" for value in FIRST)}
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
object main -250 2 556 2 2 -2     # carried along by the current: nothing in common
pause 0.3
press scan
wait state REVIEW 90
wait overlap NO* 60
press back 1
wait state AIM 20
object main -55 2 556 2 2 -2
follow {STEP_MM} 60               # back
press scan
wait state REVIEW 90
wait overlap OVERLAP* 60
press scan
wait scans 3 60
wait state AIM 60
end
"""


@dataclass(frozen=True)
class GuidedDive:
    rig: Rig
    poses: tuple[tuple[float, ...], ...]
    """Of the scans that were kept."""
    told: tuple[KeyPress | AnyView, ...]
    """Presses as they were heard and views as they were drawn."""

    @property
    def library(self) -> Library:
        return Library(self.rig.storage.root)

    @property
    def aimed(self) -> set[str]:
        """Words of the guidance as they were drawn."""
        aimed = (view for view in self.told if isinstance(view, AimView))
        return {view.guidance.english for view in aimed if view.guidance is not None}

    @property
    def reviewed(self) -> list[str]:
        """Words about the overlap as they were drawn."""
        reviewed = (view for view in self.told if isinstance(view, ReviewView))
        return list(dict.fromkeys(worded(view.overlap.label) for view in reviewed if view.overlap is not None))

    def clouds(self) -> list[Array]:
        """Return the points of every kept scan in the main's own frame, mm."""
        truth, found = true_rig(self.rig.rig.wires_options), []
        for scan, pose in zip(self.library.ids(), self.poses, strict=True):
            cloud = self.library.load(scan).cloud()
            assert cloud is not None
            R, t = pose_matrix(pose)
            found.append(np.asarray((left_to_rig(truth, cloud.points_mm) - t) @ R))
        return found


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> GuidedDive:
    folder = tmp_path_factory.mktemp("guided")
    rig = instrument(folder, SCRIPT, object_name="main", texture="slight", truth="nominal", seed=3)
    followed: list[tuple[float, ...]] = []
    told: list[KeyPress | AnyView] = []
    draw, take = Painter.draw, KeyReader.take

    def taken(reader: KeyReader) -> list[KeyEvent]:
        events = take(reader)
        told.extend(event for event in events if isinstance(event, KeyPress))
        return events

    def drawn(painter: Painter, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        told.append(view)
        return draw(painter, view, time_s)

    def seen(diver: Operator, step_mm: float, timeout_s: float) -> bool:
        arrived = follow(diver, step_mm, timeout_s)
        followed.append(diver.world.scene.pose or ())
        return arrived

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Painter, "draw", drawn)
        patch.setattr(KeyReader, "take", taken)
        patch.setattr(script, "follow", seen)
        assert run(rig) == 0
    return GuidedDive(rig, (FIRST, *followed), tuple(told))


def shares(clouds: Sequence[Array]) -> list[float]:
    """Return of each cloud but the first the share of points that the one before has too."""
    near = [cKDTree(one).query(other[::20], distance_upper_bound=3.0)[0] for one, other in pairwise(clouds)]
    return [float(np.isfinite(distance).mean()) for distance in near]


def test_who_follows_the_arrow_takes_scans_that_overlap_by_half_and_the_screen_says_the_true_overlap(
    dive: GuidedDive,
) -> None:
    assert [entry.ok for entry in dive.library.entries()] == [True] * 3
    # The main lies along x: on means to its smaller x, back to its larger.
    assert dive.poses[1][0] < 200.0
    assert dive.poses[2][0] > -55.0, dive.poses
    true = shares(dive.clouds())
    assert all(LEAST_GOOD - ALIKE < share < MOST_GOOD + ALIKE for share in true)
    assert {"GO ON", "GO BACK", "SCAN NOW"} <= {words.split(": ")[-1] for words in dive.aimed}
    first, too_far, second = dive.reviewed
    assert too_far == "NO OVERLAP: GO BACK"
    said_percent = [float(words.split()[1]) for words in (first, second)]
    assert said_percent == pytest.approx([100.0 * share for share in true], abs=5.0)


def test_no_key_in_the_menu_keeps_anyone_waiting(dive: GuidedDive) -> None:
    answered, before = 0, None
    for number, what in enumerate(dive.told):
        if not isinstance(what, KeyPress):
            before = what
        elif isinstance(before, MenuView):
            after = [view for view in dive.told[number + 1 : number + 12] if not isinstance(view, KeyPress)]
            pictures = next((k for k, view in enumerate(after, 1) if answers(before, view)), len(after) + 1)
            assert pictures <= MOST_PICTURES, f"{what} over {before}: answered by picture {pictures}"
            answered += 1
    assert answered >= 6


def answers(before: MenuView, after: AnyView) -> bool:
    """Return whether another picture than ``before`` is shown."""
    if not isinstance(after, MenuView):
        return True
    return (before.rows, before.selected, before.keys) != (after.rows, after.selected, after.keys)


def test_every_scan_carries_the_objects_number_and_the_overlap_costs_the_worker_little(dive: GuidedDive) -> None:
    shelves = (LibraryFolder.SCANS, LibraryFolder.REJECTED)
    *kept, rejected = [read(entry.folder).record for shelf in shelves for entry in dive.library.entries(shelf)]
    assert {record.object for record in (*kept, rejected)} == {1}
    assert float(np.median([record.stage_times_s["overlap_cpu"] for record in kept[1:]])) < CPU_S
