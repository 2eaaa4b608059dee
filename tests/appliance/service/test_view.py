"""What the screen is told of the machine."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine import events as on
from appliance.machine.states import Device, Part, State, boot
from appliance.ranging.marks import Marks, Track
from appliance.ranging.reach import Range, Reach
from appliance.screens.texts import to_the_minute
from appliance.screens.views import AimView, CalibrateView, SelfTestView
from appliance.service.view import Surroundings, view_of
from tests.appliance.machine.walks import UPS, aim, run

NOTHING = Surroundings(left=None, right=None, temperature_c=None, scan=None)


@pytest.mark.parametrize("failed", [None, *Part])
def test_all_is_called_ready_only_when_no_line_of_the_self_test_says_otherwise(failed: Part | None) -> None:
    parts = [on.PartTested(part, part is not failed) for part in Part]
    view = view_of(run(boot(0), *UPS, on.BootFinished(), *parts), NOTHING)
    assert isinstance(view, SelfTestView)
    assert view.finished
    assert view.passed == (failed is None)


@pytest.mark.parametrize("state", [State.AIM, State.CALIBRATE])
def test_where_a_picture_is_aimed_with_the_dots_it_shows_their_marks(state: State) -> None:
    marks = Marks((Track((0.4, 0.5), (0.5, 0.5), (0.6, 0.5)),), ())
    view = view_of(replace(boot(0), state=state), replace(NOTHING, marks=marks))
    assert isinstance(view, AimView | CalibrateView)
    assert view.marks is marks


def shown_aim(*events: on.Event) -> AimView:
    view = view_of(run(aim(), *events), NOTHING)
    assert isinstance(view, AimView)
    return view


@pytest.mark.parametrize("device", [Device.CAMERA_LEFT, Device.CAMERA_RIGHT])
def test_with_one_camera_gone_the_gauge_pretends_no_distance(device: Device) -> None:
    """It went on with a green OK and 515 mm."""
    measured = on.Ranged(Range(515.0, 0.0, 0.3, 2))
    gauge = shown_aim(measured).gauge
    assert gauge is not None
    assert (gauge.word, gauge.distance_mm) == (Reach.OK, 515.0)
    assert shown_aim(on.DeviceDown(device, "gone"), measured).gauge is None


def test_a_date_is_written_as_people_read_it() -> None:
    dates = ("2026-11-26T20:55:56+00:00", "2026-11-26T20:55:56+02:00", "no date")
    assert [to_the_minute(iso) for iso in dates] == ["2026-11-26 20:55 UTC", "2026-11-26 20:55", "no date"]
