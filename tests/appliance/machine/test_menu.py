"""The menu and the gallery with four keys and cold hands."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.calibration.guide import Step
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine import scanning
from appliance.machine.choices import Choices, offers_of
from appliance.machine.menu import Row, row_of, shown
from appliance.machine.states import Calibrating, Machine, Page, Settings, State, boot
from appliance.machine.transfer import NOT_TOLD, Serving, Transfer
from appliance.machine.words import Text
from appliance.scan.exposure import Exposure
from appliance.service.menu_view import Facts, menu_view, value_of
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import PARTS, SECOND_NS, SERVED, UPS, after, aim, in_gallery, in_menu, run

STEPS = (Exposure(5_000), Exposure(8_000), Exposure(12_000), Exposure(16_000))
BALTIC = Choices(Exposure(12_000), 16, 7.0, 11.6)


def offered() -> Machine:
    """An instrument for brackish water, in the menu."""
    settings = Settings(choices=BALTIC, offers=offers_of(BALTIC, STEPS))
    machine = run(boot(0, settings), *UPS, on.BootFinished(), *PARTS, on.Tick(SECOND_NS))
    return press(machine, Key.UP)


def press(machine: Machine, *keys: Key) -> Machine:
    return run(machine, *(on.KeyPressed(key) for key in keys))


def at(machine: Machine, row: Row) -> Machine:
    """With that row of the main page selected."""
    for _ in range(20):
        if machine.menu is not None and row_of(machine.menu) is row:
            return machine
        machine = press(machine, Key.DOWN)
    raise AssertionError(f"no way to {row}")


def test_a_value_changes_only_when_it_is_taken() -> None:
    machine = press(at(offered(), Row.EXPOSURE), Key.SCAN, Key.UP)
    assert shown(machine).exposure == Exposure(16_000)
    assert machine.exposure == Exposure(12_000), "not yet"
    assert press(machine, Key.BACK).exposure == Exposure(12_000), "never, if the diver goes back"
    taken, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert taken.exposure == Exposure(16_000)
    assert effects == [do.RememberChoices(taken.choices)]
    assert taken.state is State.MENU
    assert press(taken, Key.BACK).state is State.AIM


def test_a_page_says_what_is_chosen_and_what_would_be() -> None:
    machine, facts = replace(at(offered(), Row.PERIOD), scans=3, scans_left=None), Facts("KF-7", "2031-05-06")
    view = menu_view(press(machine, Key.SCAN, Key.UP), facts)
    said = {row.text: row.value for row in view.rows}
    assert (view.title, view.rows[view.selected].text, view.changing) == (Text.MENU, Text.FRINGES, True)
    assert (said[Text.FRINGES], said[Text.WATER]) == (Text.MEDIUM, (Text.SALT, "11.6 °C"))
    assert (value_of(Row.SALINITY, machine, None), value_of(Row.SERIAL_NUMBER, machine, facts)) == ("7 psu", "KF-7")
    assert value_of(Row.DISK, machine, None) == ("3", Text.TAKEN, "· ?", Text.LEFT_OVER)


def test_a_period_is_drawn_anew_and_the_next_scan_has_it() -> None:
    machine = press(at(offered(), Row.PERIOD), Key.SCAN, Key.UP)
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert do.UsePeriod(32) in effects
    machine, effects = after(press(machine, Key.BACK), on.KeyPressed(Key.SCAN))
    assert do.Arm(1, 32, Exposure(12_000)) in effects
    assert run(machine, on.Armed(1)).deadline_ns == machine.now_ns + round((22 / 60 + 5) * SECOND_NS)


def test_values_stop_at_their_ends() -> None:
    machine = press(at(offered(), Row.PERIOD), Key.SCAN, Key.DOWN, Key.DOWN)
    assert shown(machine).period_px == 16
    assert Key.DOWN not in labels(machine), "a key that does nothing has no label"
    machine = press(machine, *(Key.UP,) * 5)
    assert shown(machine).period_px == 64


def test_brackish_water_of_the_rig_file_is_the_salt_water_to_choose() -> None:
    machine = press(at(offered(), Row.WATER), Key.SCAN)
    assert machine.menu is not None
    assert machine.menu.page is Page.WATER
    fresh, effects = after(machine, *(on.KeyPressed(key) for key in (Key.SCAN, Key.UP, Key.SCAN)))
    assert do.UseWater(0.0, 11.6) in effects
    assert press(fresh, Key.SCAN, Key.UP, Key.SCAN).choices.salinity_psu == 7.0


def test_a_stated_temperature_goes_by_whole_degrees() -> None:
    machine = press(at(offered(), Row.WATER), Key.SCAN, Key.DOWN, Key.SCAN, Key.DOWN, Key.DOWN)
    _, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert do.UseWater(7.0, 10.0) in effects


def test_power_off_is_asked_back_and_the_first_row_does_no_harm() -> None:
    asked = press(at(offered(), Row.POWER_OFF), Key.SCAN)
    assert press(asked, Key.SCAN) == at(offered(), Row.POWER_OFF)
    machine, effects = after(asked, on.KeyPressed(Key.DOWN), on.KeyPressed(Key.SCAN))
    assert machine.state is State.SHUTDOWN
    assert effects[-1] == do.Quit(power_off=True)


def test_back_leads_one_page_up_and_then_out_and_holding_it_on_does_not_switch_off() -> None:
    machine = press(at(offered(), Row.ABOUT), Key.SCAN, Key.BACK)
    assert machine.menu is not None
    assert (machine.menu.page, row_of(machine.menu)) == (Page.MAIN, Row.ABOUT), "where it came from"
    machine = run(machine, on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))
    assert machine.state is State.AIM


@pytest.mark.parametrize("way", [in_menu, in_gallery])
def test_nothing_shines_while_nobody_aims(way: object) -> None:
    assert callable(way)
    key = Key.UP if way is in_menu else Key.DOWN
    machine, effects = after(aim(), on.KeyPressed(key))
    assert do.StopLive() in effects
    _, effects = after(machine, on.KeyPressed(Key.BACK))
    assert any(isinstance(effect, do.GoLive) for effect in effects)


def test_the_gallery_begins_with_the_newest_and_stops_at_the_oldest() -> None:
    machine, effects = after(aim(), on.KeyPressed(Key.DOWN))
    assert do.ListGallery() in effects
    machine, effects = after(machine, on.ScansListed(("000003", "000002", "000001")))
    assert effects == [do.ShowGalleryScan("000003")]
    assert labels(machine) == {Key.BACK: "BACK", Key.DOWN: "OLDER"}
    machine, effects = after(machine, *(on.KeyPressed(Key.DOWN),) * 5)
    assert effects == [do.ShowGalleryScan("000002"), do.ShowGalleryScan("000001")]
    assert labels(machine) == {Key.BACK: "BACK", Key.UP: "NEWER"}
    for key in (Key.SCAN, Key.DOWN):
        assert after(machine, on.KeyPressed(key), on.KeyHeld(key)) == (press(machine, key), []), "nothing is deleted"


def test_an_empty_gallery_can_be_left() -> None:
    machine = run(aim(), on.KeyPressed(Key.DOWN), on.ScansListed(()))
    assert labels(machine) == {Key.BACK: "BACK"}
    assert press(machine, Key.BACK).state is State.AIM


def test_a_gallery_entered_from_the_menu_leads_back_there() -> None:
    machine = press(at(in_menu(), Row.GALLERY), Key.SCAN)
    assert machine.state is State.GALLERY
    assert press(machine, Key.BACK).state is State.MENU
    assert press(machine, Key.BACK, Key.BACK).state is State.AIM


def test_an_object_is_begun_by_its_next_number_and_scans_carry_it_until_it_is_ended() -> None:
    machine = press(at(run(offered(), on.ObjectsCounted(4)), Row.OBJECT), Key.SCAN, Key.UP)
    assert shown(machine).object == 5, "scans on the disk carry up to 4"
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.RememberChoices(machine.choices)]
    assert (machine.choices.object, machine.choices.objects) == (5, 5)
    _, effects = after(press(machine, Key.BACK), on.KeyPressed(Key.SCAN))
    assert do.Arm(1, 16, Exposure(12_000), object=5) in effects
    ended = press(machine, Key.SCAN, Key.DOWN, Key.SCAN)
    assert ended.choices.object is None
    again = press(ended, Key.SCAN, Key.UP)
    assert shown(again).object == 6, "a number is never given twice"
    assert press(again, Key.BACK).choices.objects == 5, "one that was not begun is not used up"


def test_a_running_object_is_kept_or_followed_by_the_next() -> None:
    machine = press(at(run(offered(), on.ObjectsCounted(0)), Row.OBJECT), Key.SCAN, Key.UP, Key.SCAN, Key.SCAN)
    assert shown(machine).object == 1
    assert shown(press(machine, Key.UP, Key.UP, Key.UP)).object == 2
    assert shown(press(machine, Key.DOWN, Key.DOWN)).object is None


def test_no_object_is_begun_before_the_disk_has_told_which_numbers_are_used() -> None:
    machine = press(at(offered(), Row.OBJECT), Key.SCAN)
    assert Key.UP not in labels(machine)
    assert shown(press(machine, Key.UP)).object is None


def test_recordings_of_a_calibration_belong_to_no_object() -> None:
    chosen = replace(BALTIC, object=3, objects=3)
    machine = replace(aim(), choices=chosen, calibrating=Calibrating(Step.M1))
    _, effects = scanning.arm(machine)
    assert [effect.object for effect in effects if isinstance(effect, do.Arm)] == [None]
    _, effects = scanning.arm(replace(aim(), choices=chosen))
    assert [effect.object for effect in effects if isinstance(effect, do.Arm)] == [3]


# -------------------------------------------------------------------------------- scans for a desk


def transferring() -> Machine:
    machine = press(at(offered(), Row.TRANSFER), Key.SCAN)
    return press(machine, Key.SCAN, Key.UP, Key.SCAN)


def test_the_transfer_is_off_until_it_is_switched_on_and_that_is_taken() -> None:
    machine = press(at(offered(), Row.TRANSFER), Key.SCAN)
    assert value_of(Row.TRANSFER, machine, None) is Text.OFF
    looked_at = press(machine, Key.SCAN, Key.UP, Key.BACK)
    assert not looked_at.choices.transfer
    taken, effects = after(machine, *(on.KeyPressed(key) for key in (Key.SCAN, Key.UP, Key.SCAN)))
    assert effects.count(do.SwitchTransfer(to_on=True)) == 1
    assert value_of(Row.TRANSFER_SWITCH, taken, None) is Text.STARTING
    off, effects = after(taken, *(on.KeyPressed(key) for key in (Key.SCAN, Key.DOWN, Key.SCAN)))
    assert do.SwitchTransfer(to_on=False) in effects
    assert value_of(Row.TRANSFER_SWITCH, off, None) is Text.OFF


def test_the_diver_reads_where_it_is_served_and_for_how_many_keys() -> None:
    def said(told: Transfer) -> tuple[object, ...]:
        machine = run(transferring(), on.TransferTold(told))
        return tuple(value_of(row, machine, None) for row in (Row.TRANSFER_SWITCH, Row.ADDRESS, Row.KEYS))

    assert said(Transfer(Serving.ON, "169.254.3.4", 2)) == (Text.ON, "169.254.3.4", "2")
    assert said(Transfer(Serving.ON, None, 0)) == (Text.ON, Text.NO_NETWORK, Text.PLUG_STICK_IN)
    assert said(Transfer(Serving.ON, None, None)) == (Text.ON, Text.NO_NETWORK, "")
    assert said(Transfer(Serving.FAILED)) == (Text.TRANSFER_FAILED, "", "")


def test_what_was_told_of_the_transfer_is_gone_when_it_is_off() -> None:
    machine = run(transferring(), on.TransferTold(SERVED))
    off = press(machine, Key.SCAN, Key.DOWN, Key.SCAN)
    late = run(off, on.TransferTold(SERVED))
    assert (off.transfer, late.transfer) == (NOT_TOLD, NOT_TOLD)


def test_address_and_keys_are_read_and_not_opened() -> None:
    machine = press(transferring(), Key.DOWN)
    assert labels(machine) == {Key.BACK: "BACK", Key.UP: "▲", Key.DOWN: "▼"}
    assert press(machine, Key.SCAN) == machine
