"""What the screen is told of the machine."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine import events as on
from appliance.machine.states import Part, State, boot
from appliance.ranging.marks import Marks, Track
from appliance.screens.views import AimView, CalibrateView, SelfTestView
from appliance.service.view import Surroundings, view_of
from tests.appliance.machine.walks import UPS, run

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
