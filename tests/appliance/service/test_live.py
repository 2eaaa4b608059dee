"""Live views: what is told to which device, in which order, and whose images are taken."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Device
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.service.live import LiveViews
from tests.appliance.capture.test_course_of_a_scan import SEQUENCE, N
from tests.appliance.service.scripted import Desk, a_desk
from tests.appliance.service.test_shining import POINTERS

EXPOSURE = Exposure(8_000, 6.0)
NOTHING = np.zeros((1, 1), np.uint8)
DARK, LIT = len(SEQUENCE), len(SEQUENCE) + 1


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with a_desk(tmp_path) as made:
        made.said()
        yield made


def until(desk: Desk, happened: Callable[[], object]) -> None:
    end_ns = desk.script.clock.now_ns() + 5_000_000_000
    while not happened():
        assert desk.script.clock.now_ns() < end_ns
        desk.script.clock.sleep_s(0.002)


@pytest.mark.parametrize(("light", "shown"), [(True, LIT), (False, DARK)])
def test_the_lasers_are_off_and_the_light_is_as_wanted_before_the_board_fires(
    desk: Desk, light: bool, shown: int
) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(light, True, EXPOSURE), aiming=True, belongs_to=3)
    board = desk.rig.board
    fired = f"live every {board.live_every_vsyncs} delay {board.trigger_delay_us} width 8000"
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {shown}", "stop", "lasers False False", fired]
    until(desk, lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    live.end()
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {DARK}", "lasers False False", "stop"]
    assert desk.inbox == []


def test_each_camera_is_exposed_as_wanted_and_shows_its_latest_image(desk: Desk) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(True, False, EXPOSURE), aiming=False, belongs_to=None)
    until(desk, lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    assert {"left 8000 us 6 dB", "right 8000 us 6 dB"} <= set(desk.said())
    for shown in (1, 2):
        show(desk, shown)

        def all_seen(value: int = shown) -> bool:
            live.take()
            return {side: int(image[0, 0]) for side, image in live.images.items()} == {"left": value, "right": value}

        until(desk, all_seen)
    desk.devices.cameras["left"].lose("unplugged")
    live.take()
    assert set(live.images) == {"right"}, "an old image is no live one"


def test_what_fails_meanwhile_is_told_at_the_next_heartbeat(desk: Desk) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    for device, lose in ((Device.PROJECTOR, desk.devices.projector.lose), (Device.BOARD, desk.devices.board.lose)):
        assert lose("gone") == [on.DeviceDown(device, "gone")]
    live.begin(do.GoLive(True, True, EXPOSURE), aiming=True, belongs_to=None)
    assert live.switch_lasers_on() == []
    live.end()
    assert all(not said.startswith(("show", "live", "lasers")) for said in desk.said())


def show(desk: Desk, patterns: int) -> None:
    with desk.script.blank:
        desk.script.shown = patterns
        desk.script.blank.notify_all()


def test_the_lasers_go_on_once_two_pairs_were_seen_without_them(tmp_path: Path) -> None:
    with a_desk(tmp_path, POINTERS) as desk:
        live = LiveViews(desk.rig, desk.parts, desk.inbox)
        live.begin(do.GoLive(True, True, EXPOSURE), aiming=True, belongs_to=None)
        desk.script.clock.sleep_s(0.21)  # the light has settled
        desk.said()
        for pair in range(1, N + 1):
            assert (live.switch_lasers_on(), desk.said()) == ([], [])
            show(desk, pair)
            end_ns = desk.script.clock.now_ns() + 60_000_000
            while desk.script.clock.now_ns() < end_ns and not desk.parts.ranging.wants_lasers:
                live.take()
                desk.parts.ranging.poll()
                desk.script.clock.sleep_s(0.002)
            if desk.parts.ranging.wants_lasers:
                break
        conducts_neither = live.switch_lasers_on()
        assert desk.said() == ["lasers True True"]
        assert [event.fault.device for event in conducts_neither if isinstance(event, on.ConditionRaised)] == [
            "laser.left", "laser.right",
        ]  # fmt: skip
        assert live.switch_lasers_on() == [], "they are on"


@pytest.mark.parametrize(("light", "aiming"), [(True, True), (True, False), (False, True)])
def test_too_dark_a_picture_is_told_of_while_the_diver_aims_by_the_projectors_light(
    desk: Desk, light: bool, aiming: bool
) -> None:
    live, told = LiveViews(desk.rig, desk.parts, desk.inbox), list[on.Event]()
    live.begin(do.GoLive(light, False, EXPOSURE), aiming=aiming, belongs_to=None)
    desk.script.clock.sleep_s(0.31)  # the light has settled
    for picture in range(1, 8):
        show(desk, picture)

        def taken(value: int = picture) -> bool:
            live.take()
            return int(live.images.get("left", NOTHING)[0, 0]) == value

        until(desk, taken)
        until(desk, lambda: not desk.parts.aiming.busy)
        told += desk.parts.aiming.poll()
    dark = [event.fault.code for event in told if isinstance(event, on.ConditionRaised)]
    assert dark == ([FaultCode.AIM_DARK] if light and aiming else [])
    live.begin(do.GoLive(light, False, EXPOSURE), aiming=aiming, belongs_to=None)
    cleared = [event.code for event in desk.inbox if isinstance(event, on.ConditionCleared)]
    assert cleared == dark, "with the live view that it came of"
