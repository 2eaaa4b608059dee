"""When a coil's count is a press: drift, noise, held keys, and coils that fail."""

from __future__ import annotations

import pytest

from drivers.keys.firmware.coils import TRIES, CoilFollower
from drivers.keys.report import parse_report
from tests.drivers.keys.firmware.desk import RESTING, PadDesk

pytestmark = pytest.mark.devices


@pytest.fixture
def desk() -> PadDesk:
    made = PadDesk()
    made.run(3000)
    return made


def pressed(desk: PadDesk, time_ms: int) -> set[int]:
    """Return all masks of pressed keys that were reported within that time."""
    return {report[1] for _, report in desk.run(time_ms)}


def works(desk: PadDesk, key: int = 0) -> bool:
    """Press and release a key, and tell whether that was heard."""
    seen = []
    for down in (True, False):
        desk.finger(key, down)
        desk.run(500)
        seen.append((pressed(desk, 500), desk.hardware.lit))
    return seen == [({1 << key}, True), ({0}, False)]


@pytest.mark.parametrize("raises", [True, False], ids=["count rises", "count falls"])
def test_a_finger_is_a_press_whichever_way_the_chip_counts(raises: bool) -> None:
    desk = PadDesk()
    desk.hardware.press_raises = raises
    desk.run(3000)
    assert works(desk)


@pytest.mark.parametrize("ppm_s", [-40.0, 40.0])
def test_drift_is_no_press_and_presses_are_heard_all_the_same(ppm_s: float) -> None:
    desk = PadDesk()
    desk.hardware.drift_ppm_s = ppm_s
    assert pressed(desk, 120_000) == {0}, "4800 ppm of drift, sixteen thresholds"
    assert works(desk)
    desk.hardware.noise_ppm = 120
    desk.run(20_000)
    assert pressed(desk, 60_000) == {0}
    assert desk.core._coils[0].threshold() / 256 > RESTING[0] * 300e-6 * 1.05, "loud coils have a higher one"


def test_a_key_that_is_held_stays_pressed_for_the_stuck_keys_time_and_is_a_new_rest_after_a_minute(
    desk: PadDesk,
) -> None:
    desk.finger(0, True)
    desk.run(300)
    assert pressed(desk, 40_000) == {1}
    desk.run(30_000)
    assert pressed(desk, 1000) == {0}
    # The dent is gone again: beyond the rest on the other side.
    desk.finger(0, False)
    desk.run(2000)
    assert works(desk)


def test_a_key_that_was_held_at_power_on_works_once_it_was_released() -> None:
    desk = PadDesk()
    desk.hardware.bend_ppm[0] = 900
    desk.finger(0, True)
    assert pressed(desk, 3000) == {0}
    desk.finger(0, False)
    desk.run(500)
    assert works(desk)


def test_a_trembling_finger_does_not_make_the_key_flutter_and_fewer_samples_than_that_make_no_fault() -> None:
    follower = CoilFollower()
    for _ in range(200):
        follower.follow(4_000_000, True)
    changes = 0
    for i in range(100):
        before = follower.pressed
        # From 220 to 340 ppm: around the press threshold of 300, above that of the release.
        follower.follow(4_000_000 + (880 if i % 2 else 1360), True)
        changes += follower.pressed != before
    assert changes == 1
    for sample, times, faulty in (
        (None, TRIES - 1, False),
        (4_000_000, 1, False),
        (None, TRIES - 1, False),
        (None, 1, True),
    ):
        for _ in range(times):
            follower.follow(sample, True)
        assert follower.faulty is faulty


def test_a_coil_that_stops_is_faulty_and_not_pressed_and_comes_back_resting_where_it_is_then(desk: PadDesk) -> None:
    desk.finger(2, True)
    desk.run(300)
    desk.hardware.broken[2] = True
    report = parse_report(desk.run(300)[-1][1])
    assert {key.name for key in report.faulty} == {"UP"}
    assert not report.pressed
    desk.finger(2, False)
    desk.hardware.offset_ppm[2] = 3000.0
    desk.hardware.broken[2] = False
    desk.run(600)
    assert not parse_report(desk.run(300)[-1][1]).faulty
    assert pressed(desk, 2000) == {0}
    assert works(desk, 2)


def test_a_change_that_usb_did_not_take_is_told_later_and_no_number_is_lost(desk: PadDesk) -> None:
    before = desk.run(500)[-1][1][2]
    desk.hardware.listening = False
    desk.finger(0, True)
    assert desk.run(1000) == []
    desk.hardware.listening = True
    first = desk.run(20)[0][1]
    assert first[1] == 1
    assert first[2] == (before + 1) % 256
