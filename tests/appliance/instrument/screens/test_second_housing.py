"""Every screen of the second housing, by its rig file alone: its distances, its reach, its number of images, and nothing cut or covered."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from appliance.calibrate.guide import HELD, RecordingCheck, Refusal, Session, Step
from appliance.calibrate.recordings import ArtefactKind
from appliance.cli.simrig import default_sim_rig
from appliance.instrument.machine.states import Calibrating, Device, State, boot
from appliance.instrument.machine.words import Language
from appliance.instrument.ranging.reach import Range, Reach, reach_of
from appliance.instrument.screens.canvas import TextLine
from appliance.instrument.screens.painter import Painter
from appliance.instrument.screens.views import AimView, AnyView, CalibrateView, GalleryView, ReviewView
from appliance.instrument.service.settings import machine_settings
from appliance.instrument.service.view import Surroundings, view_of
from appliance.measure.light.volume import WorkingVolume
from appliance.store.config import Rig, load_rig
from tests.appliance.instrument.screens.golden.scenes import SCENES
from tests.appliance.instrument.screens.test_legible import DATA, complaints, written

WORKING_MM = 300.0
FARTHEST_SAID_MM = 0.6 * 620.0
"""The farthest place of any plane, as docs/adr/0065 makes this housing's of the standard one's."""
NOTHING = Surroundings(left=None, right=None, temperature_c=None, scan=None)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(default_sim_rig().with_name("compact.toml"))


def said_mm(lines: list[TextLine]) -> set[float]:
    """Lengths in mm of 100 and more that are written: distances, not errors."""
    alone = {float(line.text) for line in lines if re.fullmatch(r"\d{3}", line.text)}
    pairs = [pair for line in lines for pair in re.findall(r"(\d{3,4})(?:\D{1,5}(\d{3,4}))?\s*mm", line.text)]
    return alone | {float(one) for pair in pairs for one in pair if one}


def of_this_housing(view: AnyView, volume: WorkingVolume) -> AnyView:
    """The view as this housing's machine gives it: the rig file's volume, and distances that occur there."""
    if isinstance(view, AimView | CalibrateView) and view.gauge is not None:
        far_mm = view.gauge.distance_mm
        scaled = None if far_mm is None else volume.scaled(far_mm)
        view = replace(view, gauge=replace(view.gauge, distance_mm=scaled, volume=volume))
    if isinstance(view, CalibrateView):
        view = replace(view, volume=volume)
    if isinstance(view, ReviewView):
        scale = np.float32(volume.scaled(1.0))
        view = replace(view, points_mm=view.points_mm * scale, values=view.values * scale)
        view = replace(view, distance_mm=volume.scaled(view.distance_mm or 0.0))
    if isinstance(view, GalleryView) and view.scan is not None and view.scan.distance_mm is not None:
        view = replace(view, scan=replace(view.scan, distance_mm=volume.scaled(view.scan.distance_mm)))
    return view


@pytest.mark.parametrize("language", list(Language))
def test_no_screen_says_a_distance_of_the_other_housing(painter: Painter, rig: Rig, language: Language) -> None:
    volume = machine_settings(rig).volume
    painter.language = language
    for name, scene in SCENES.items():
        view = replace(of_this_housing(scene.view, volume), alerts=())
        _, lines = written(painter, view, scene.time_s)
        assert all(mm <= FARTHEST_SAID_MM for mm in said_mm(lines)), name
        assert not complaints(painter.canvas, view, lines, may_be_cut=name in DATA), name
    standard = said_mm(written(painter, replace(SCENES["aim-closer"].view, alerts=()))[1])
    assert max(standard) > 560.0, "or nothing was looked for"


@pytest.mark.parametrize(
    ("step", "away_mm", "allowed_mm"), [(Step.M3, 282.0, {258.0, 309.0}), (Step.M4, 342.0, {318.0, 372.0})]
)
def test_the_guide_of_the_calibration_asks_for_this_housings_distances(
    painter: Painter, rig: Rig, step: Step, away_mm: float, allowed_mm: set[float]
) -> None:
    assert HELD[step] is ArtefactKind.PLANE
    machine = replace(boot(0, machine_settings(rig)), state=State.CALIBRATE, calibrating=Calibrating(step))
    assert said_mm(written(painter, view_of(machine, NOTHING))[1]) == {away_mm}
    refused = Calibrating(step, latest=RecordingCheck(step, Refusal.TOO_NEAR, 200.0, 2000))
    view = view_of(replace(machine, calibrating=refused, session=Session()), NOTHING)
    assert allowed_mm <= said_mm(written(painter, view)[1])


def test_aiming_is_right_at_300_mm_and_too_far_where_the_other_housing_works(rig: Rig) -> None:
    machine = replace(boot(0, machine_settings(rig)), state=State.AIM, lasers_off_since_ns=None, up=frozenset(Device))
    for mm, reach in ((WORKING_MM, Reach.OK), (500.0, Reach.CLOSER), (200.0, Reach.BACK)):
        measured = Range(mm, 0.0, 1.0, 2)
        view = view_of(replace(machine, range=measured), NOTHING)
        assert isinstance(view, AimView)
        assert view.gauge is not None
        volume = view.gauge.volume
        assert (volume.nearest_mm, volume.working_mm, volume.farthest_mm) == (265.0, WORKING_MM, 335.0)
        assert reach_of(measured, Reach.UNKNOWN, volume) is reach


def test_a_scan_that_lost_an_image_is_counted_by_this_housings_sequence(rig: Rig) -> None:
    assert machine_settings(rig).frames == {16: 25, 32: 23, 64: 21}
