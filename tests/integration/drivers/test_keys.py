"""The key pad driver against the simulated pad."""

from __future__ import annotations

import pytest

from drivers.api import DeviceGone, Key, KeyEvent, KeyLongPress, KeyPress, KeyRelease, KeysLost, KeyStuck
from drivers.keys import HidKeypad
from tests.integration.drivers.conftest import Rig


def during(rig: Rig, keys: HidKeypad, duration_s: float) -> list[KeyEvent]:
    end_ns = rig.wires.clock.now_ns() + round(duration_s * 1e9)
    said: list[KeyEvent] = []
    while rig.wires.clock.now_ns() < end_ns:
        event = keys.next_event(0.05)
        if event is not None:
            said.append(event)
            if isinstance(event, KeysLost):
                break
    return said


@pytest.mark.parametrize("key", Key)
def test_one_press_is_one_press_of_that_key(rig: Rig, key: Key) -> None:
    keys = rig.keys()
    rig.world.press(key.value, hold_s=0.15)
    said = during(rig, keys, 0.6)
    assert [type(event) for event in said] == [KeyPress, KeyRelease], said
    press, release = said
    assert isinstance(press, KeyPress)
    assert isinstance(release, KeyRelease)
    assert (press.key, release.key) == (key, key)
    assert release.held_s == pytest.approx(0.15, abs=0.045)


def test_the_screen_can_answer_within_100_ms(rig: Rig) -> None:
    keys = rig.keys()
    waited_s = []
    for _ in range(3):  # the fastest counts: world time runs on while a busy machine lets the host wait
        begin_ns = rig.world.time_ns
        rig.world.press("scan", hold_s=0.3)
        event = keys.next_event(1.0)
        waited_s.append((rig.world.time_ns - begin_ns) * 1e-9)
        assert isinstance(event, KeyPress)
        assert isinstance(keys.next_event(1.0), KeyRelease)
    assert min(waited_s) < 0.09


def test_a_long_press_is_press_long_release(rig: Rig) -> None:
    keys = rig.keys()
    rig.world.press("back", hold_s=1.1)
    said = during(rig, keys, 1.6)
    assert [type(event) for event in said] == [KeyPress, KeyLongPress, KeyRelease], said


@pytest.mark.parametrize("rig", [8.0], indirect=True, ids=["fast"])
def test_a_stuck_key_is_told_and_the_others_live(rig: Rig) -> None:
    keys = rig.keys()
    rig.world.fault("key.scan stuck")
    said = during(rig, keys, 8.6)
    assert said[-1] == KeyStuck(Key.SCAN)
    rig.world.press("up", hold_s=0.15)
    assert [type(event) for event in during(rig, keys, 0.5)] == [KeyPress, KeyRelease]


def test_garbage_presses_nothing(rig: Rig) -> None:
    keys = rig.keys()
    rig.world.fault("keypad garbage for_s=0.8")
    said = during(rig, keys, 0.8)
    assert not [event for event in said if not isinstance(event, KeysLost)]
    assert keys.counters.garbage_reports > 0


def test_an_unplugged_pad_is_lost_and_can_be_opened_again(rig: Rig) -> None:
    keys = rig.keys()
    rig.world.fault("keypad off")
    said = during(rig, keys, 2.0)
    assert [type(event) for event in said] == [KeysLost]
    assert not keys.health().ok
    keys.close()
    with pytest.raises(DeviceGone, match="no key pad"):
        rig.keys()
    rig.world.clear_faults()
    again = rig.keys()
    rig.world.press("down", hold_s=0.15)
    assert [type(event) for event in during(rig, again, 0.5)] == [KeyPress, KeyRelease]
