"""What the screen is told of the machine."""

from __future__ import annotations

import pytest

from appliance.machine import events as on
from appliance.machine.states import Part, boot
from appliance.screens.views import SelfTestView
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
