"""The menu and the gallery with four keys and cold hands: what the diver may choose, and where each choice ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.calibrate.guide import Step
from appliance.instrument.machine import asking, calibrate, choices, gallery, menu, scanning
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.menu import Row, row_of, shown
from appliance.instrument.machine.states import (
    TRANSFER_UNKNOWN,
    Calibrating,
    Machine,
    Page,
    Serving,
    Settings,
    State,
    Transfer,
    boot,
)
from appliance.instrument.machine.words import Text
from appliance.instrument.service.view import Facts, menu_view, value_of
from appliance.measure.light.exposure import Exposure
from drivers.api import Key, KeyLongPress, KeyPress
from tests.appliance.instrument.machine.courses import BACK, DOWN, SCAN, UP, Then, course, seen
from tests.appliance.instrument.machine.walks import (
    PARTS,
    SECOND_NS,
    SERVED,
    UPS,
    aim,
    calibrating,
    in_gallery,
    in_menu,
    labels,
    reviewing,
    run,
)

S = State
STEPS = (Exposure(5_000), Exposure(8_000), Exposure(12_000), Exposure(16_000))
BALTIC = choices.Choices(Exposure(12_000), 16, 7.0, 11.6)


def offered() -> Machine:
    """An instrument for brackish water, in the menu."""
    settings = Settings(choices=BALTIC, offers=choices.offers_of(BALTIC, STEPS))
    return run(boot(0, settings), *UPS, on.BootFinished(), *PARTS, on.Tick(SECOND_NS), UP)


def at(row: Row, machine: Machine | None = None) -> Callable[[], Machine]:

    def found() -> Machine:
        there = machine or offered()
        for _ in range(20):
            if there.menu is not None and row_of(there.menu) is row:
                return there
            there = run(there, DOWN)
        raise AssertionError(f"no way to {row}")

    return found


def transferring() -> Machine:
    return run(at(Row.TRANSFER)(), SCAN, SCAN, UP, SCAN)


def with_object() -> Machine:
    return run(at(Row.OBJECT, run(offered(), on.ObjectsCounted(4)))(), SCAN, UP, SCAN)


def taken(**changes: object) -> choices.Choices:
    return replace(BALTIC, **changes)  # type: ignore[arg-type]


def listed(*scans: str) -> on.ScansListed:
    return on.ScansListed(scans)


ALL = listed("000003", "000002", "000001")


@pytest.mark.parametrize(
    ("start", "events", "facts"),
    [
        course("a value is not taken by looking", at(Row.EXPOSURE), SCAN, UP, exposure=Exposure(12_000)),
        course("never, if the diver goes back", at(Row.EXPOSURE), SCAN, UP, BACK, exposure=Exposure(12_000)),
        course("but by OK", at(Row.EXPOSURE), SCAN, UP, SCAN, exposure=Exposure(16_000), state=S.MENU,
               effects=[do.UseChoices(BALTIC, taken(exposure=Exposure(16_000)))]),
        course("a period is drawn anew", at(Row.PERIOD), SCAN, UP, SCAN, among=do.UseChoices(BALTIC, taken(period_px=32))),
        course("the next scan has it", at(Row.PERIOD), SCAN, UP, SCAN, BACK, SCAN, among=do.Arm(1, 32, Exposure(12_000))),
        course("and its time", at(Row.PERIOD), SCAN, UP, SCAN, BACK, SCAN, on.Armed(1), deadline_ns=SECOND_NS + round((22 / 60 + 5) * SECOND_NS)),
        course("values stop at their ends", at(Row.PERIOD), SCAN, DOWN, DOWN, on_down=None),
        course("fresh water", at(Row.WATER), SCAN, SCAN, UP, SCAN, among=do.UseChoices(BALTIC, taken(salinity_psu=0.0))),
        course("and the rig file's brackish again", at(Row.WATER), SCAN, SCAN, UP, SCAN, SCAN, UP, SCAN, choices=BALTIC),
        course("whole degrees", at(Row.WATER), SCAN, DOWN, SCAN, DOWN, DOWN, SCAN, among=do.UseChoices(BALTIC, taken(water_c=10.0))),
        course("the first answer does no harm", at(Row.POWER_OFF), SCAN, SCAN, menu=at(Row.POWER_OFF)().menu, state=S.MENU),
        course("the second one switches off", at(Row.POWER_OFF), SCAN, DOWN, SCAN, state=S.SHUTDOWN, among=do.Quit(power_off=True)),
        course("BACK leads to where it came from", at(Row.ABOUT), SCAN, BACK, menu=at(Row.ABOUT)().menu),
        course("and out, held on it does not switch off", at(Row.ABOUT), SCAN, BACK, BACK, KeyLongPress(Key.BACK, 0), state=S.AIM, asked=False),
        *(course(f"nothing shines in the {name}", aim, key, among=do.Wish.DARK) for name, key in (("menu", UP), ("gallery", DOWN))),
        *(course(f"and it does after the {name}", aim, key, BACK, state=S.AIM, effects=[do.GoLive(True, True, Exposure(12_000))])
          for name, key in (("menu", UP), ("gallery", DOWN))),
        # The gallery.
        course("the gallery asks the disk", aim, DOWN, among=do.Wish.LIST_GALLERY, looked_at=None, labels={Key.BACK: "BACK"}),
        course("and goes nowhere before it has told", aim, DOWN, UP, DOWN, state=S.GALLERY, effects=[], looked_at=None),
        course("it begins with the newest", aim, DOWN, ALL, effects=[do.ShowGalleryScan("000003")], labels={Key.BACK: "BACK", Key.DOWN: "OLDER"}),
        course("older", in_gallery, DOWN, effects=[do.ShowGalleryScan("000002")]),
        course("newer", in_gallery, DOWN, UP, effects=[do.ShowGalleryScan("000003")]),
        course("and stops at the oldest", in_gallery, *(DOWN,) * 5, looked_at="000001", effects=[], labels={Key.BACK: "BACK", Key.UP: "NEWER"}),
        course("nothing is deleted", in_gallery, SCAN, KeyLongPress(Key.SCAN, 0), looked_at="000003", effects=[]),
        course("the only scan has no neighbours", aim, DOWN, listed("000001"), labels={Key.BACK: "BACK"}),
        course("a scan stays when others come", in_gallery, DOWN, listed("000004", "000003", "000002"), effects=[do.ShowGalleryScan("000002")]),
        course("until it goes itself", in_gallery, DOWN, listed("000004", "000003"), effects=[do.ShowGalleryScan("000004")]),
        course("or all do", in_gallery, DOWN, listed(), effects=[], looked_at=None, labels={Key.BACK: "BACK"}),
        course("an empty one can be left", aim, DOWN, listed(), BACK, state=S.AIM),
        course("from the menu it leads back there", at(Row.GALLERY, in_menu()), SCAN, BACK, state=S.MENU),
        # Objects.
        course("an object begins with the next number", with_object, choices=taken(object=5, objects=5)),
        course("scans carry it", with_object, BACK, SCAN, among=do.Arm(1, 16, Exposure(12_000), object=5)),
        course("until it is ended", with_object, SCAN, DOWN, SCAN, choices=taken(object=None, objects=5)),
        course("one that was not begun is not used up", with_object, SCAN, DOWN, SCAN, SCAN, UP, BACK, choices=taken(object=None, objects=5)),
        course("no number before the disk has told", at(Row.OBJECT), SCAN, on_up=None),
        # Scans for a desk.
        course("looked at it is not switched on", at(Row.TRANSFER), SCAN, SCAN, UP, BACK, choices=BALTIC),
        course("but when it is taken", at(Row.TRANSFER), SCAN, SCAN, UP, SCAN, among=do.UseChoices(BALTIC, taken(transfer=True))),
        course("and off again", transferring, SCAN, DOWN, SCAN, among=do.UseChoices(taken(transfer=True), BALTIC)),
        course("what was told is gone then", transferring, SERVED, SCAN, DOWN, SCAN, SERVED, transfer=TRANSFER_UNKNOWN),
        course("address and keys are read", transferring, DOWN, labels={Key.BACK: "BACK", Key.UP: "▲", Key.DOWN: "▼"}),
        course("and not opened", transferring, DOWN, SCAN, menu=run(transferring(), DOWN).menu),
    ],
)  # fmt: skip
def test_the_menu_takes_its_course(
    start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, object]
) -> None:
    assert seen(start, events, facts) == facts


@pytest.mark.parametrize(
    ("way", "keys", "drafted"),
    [
        (at(Row.EXPOSURE), (SCAN, UP), {"exposure": Exposure(16_000)}), (at(Row.PERIOD), (SCAN, DOWN, DOWN), {"period_px": 16}),
        (at(Row.PERIOD), (SCAN, *(UP,) * 5), {"period_px": 64}), (with_object, (SCAN, UP, UP, UP), {"object": 6}),
        (with_object, (SCAN, DOWN, DOWN), {"object": None}), (with_object, (SCAN, DOWN, SCAN, SCAN, UP), {"object": 6}),
        (at(Row.OBJECT), (SCAN, UP), {"object": None}),
    ],
)  # fmt: skip
def test_what_would_be_chosen_is_shown_before(
    way: Callable[[], Machine], keys: tuple[on.Event, ...], drafted: dict[str, object]
) -> None:
    found = shown(run(way(), *keys))
    assert {name: getattr(found, name) for name in drafted} == drafted


def test_a_page_says_what_is_chosen_and_what_would_be() -> None:
    machine, facts = replace(at(Row.PERIOD)(), scans=3, scans_left=None), Facts("KF-7", "2031-05-06")
    view = menu_view(run(machine, SCAN, UP), facts)
    said = {row.text: row.value for row in view.rows}
    assert (view.title, view.rows[view.selected].text, view.changing) == (Text.MENU, Text.FRINGES, True)
    assert (said[Text.FRINGES], said[Text.WATER]) == (Text.MEDIUM, (Text.SALT, "11.6 °C"))
    assert (value_of(Row.SALINITY, machine, None), value_of(Row.SERIAL_NUMBER, machine, facts)) == ("7 psu", "KF-7")
    assert value_of(Row.DISK, machine, None) == ("3", Text.TAKEN, "· ?", Text.LEFT_OVER)
    assert value_of(Row.TRANSFER, machine, None) is Text.OFF


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (TRANSFER_UNKNOWN, (Text.STARTING, "", "")),
        (Transfer(Serving.ON, "169.254.3.4", 2), (Text.ON, "169.254.3.4", "2")),
        (Transfer(Serving.ON, None, 0), (Text.ON, Text.NO_NETWORK, Text.PLUG_STICK_IN)),
        (Transfer(Serving.ON, None, None), (Text.ON, Text.NO_NETWORK, "")),
        (Transfer(Serving.FAILED), (Text.TRANSFER_FAILED, "", "")),
    ],
)
def test_the_diver_reads_where_it_is_served_and_for_how_many_keys(told: Transfer, said: tuple[object, ...]) -> None:
    machine = run(transferring(), told)
    assert tuple(value_of(row, machine, None) for row in (Row.TRANSFER_SWITCH, Row.ADDRESS, Row.KEYS)) == said


def test_recordings_of_a_calibration_belong_to_no_object() -> None:
    chosen = taken(object=3, objects=3)
    for calibration, number in ((Calibrating(Step.M1), None), (None, 3)):
        _, effects = scanning.arm(replace(aim(), choices=chosen, calibrating=calibration))
        assert [effect.object for effect in effects if isinstance(effect, do.Arm)] == [number]


def test_a_new_instrument_scans_in_fresh_water_of_20_degrees_with_the_finest_fringes_in_english() -> None:
    assert choices.Choices() == choices.Choices(period_px=16, salinity_psu=0.0, water_c=20.0, language="en")
    assert (choices.Offers().periods_px, choices.Offers().fresh_psu, choices.Offers().salt_psu) == (
        (16, 32, 64),
        0.0,
        35.0,
    )


@pytest.mark.parametrize(("psu", "salt"), [(0.0, False), (1.9, False), (2.0, True), (35.0, True)])
def test_water_is_salt_from_two_grams_in_a_kilogram_on(psu: float, salt: bool) -> None:
    chosen = choices.Choices(salinity_psu=psu)
    offers = choices.offers_of(chosen, STEPS)
    assert chosen.salt == salt
    assert (offers.fresh_psu, offers.salt_psu) == ((0.0, psu) if salt else (psu, 35.0))
    other = choices.other_water(chosen, offers)
    assert (other.salt, choices.other_water(other, offers)) == (not salt, chosen)


@pytest.mark.parametrize(
    ("start_us", "by", "found_us"),
    [
        (5_000, -1, 5_000),
        (5_000, 1, 8_000),
        (16_000, 1, 16_000),
        (16_000, -2, 8_000),
        (10_000, 1, 12_000),
        (10_000, -1, 8_000),
    ],
)
def test_exposures_go_by_the_light_they_give_and_stay_at_their_ends(start_us: int, by: int, found_us: int) -> None:
    offers = choices.offers_of(choices.Choices(), (*STEPS[:3], Exposure(16_000), Exposure(16_000, 6.0)))
    assert choices.another_exposure(choices.Choices(exposure=Exposure(16_000)), offers, 1).exposure == Exposure(
        16_000, 6.0
    )
    chosen = choices.another_exposure(
        choices.Choices(exposure=Exposure(start_us)), choices.offers_of(choices.Choices(), STEPS), by
    )
    assert chosen.exposure == Exposure(found_us)


def test_periods_languages_and_whole_degrees_stay_at_their_ends() -> None:
    chosen, offers = choices.Choices(), choices.Offers()
    assert [choices.another_period(chosen, offers, by).period_px for by in (-1, 0, 1, 2, 3)] == [16, 16, 32, 64, 64]
    assert [choices.another_period(choices.Choices(period_px=24), offers, by).period_px for by in (-1, 1)] == [16, 32]
    assert [choices.another_language(chosen, by).language for by in (-1, 1)] == ["de", "en"]
    assert choices.another_language(choices.Choices(language="de"), 1).language == "en"
    degrees = {
        (20.0, 1): 21.0,
        (11.6, 1): 13.0,
        (11.4, -1): 10.0,
        (-1.0, -1): -2.0,
        (-2.0, -1): -2.0,
        (39.0, 1): 40.0,
        (40.0, 1): 40.0,
    }
    assert {(c, by): choices.warmer(choices.Choices(water_c=c), by).water_c for c, by in degrees} == degrees


@pytest.mark.parametrize(
    "broken",
    [
        lambda: replace(in_menu(), menu=None),
        lambda: replace(in_gallery(), gallery=None),
        lambda: replace(reviewing(), scan=None),
        lambda: replace(calibrating(), calibrating=None),
    ],
)
def test_a_state_without_what_belongs_to_it_leads_to_aim_with_any_key(broken: Callable[[], Machine]) -> None:
    for key in Key:
        labels(broken())
        assert run(broken(), KeyPress(key, 0)).state is S.AIM


def test_where_nothing_is_asked_there_is_nothing_to_answer() -> None:
    for key in Key:
        assert asking.pressed(aim(), key) == (aim(), ())
        assert asking.other_answer(aim(), key) is None
        assert calibrate.neighbour(aim(), key) is None
        assert not menu.may_move(aim(), key)
        assert not gallery.may_move(aim(), key)
    assert asking.unanswered(aim()) == asking.without_acknowledged(aim()) == aim()
    assert calibrate.decision(aim()) is None
    assert not menu.may_choose(aim())
    assert not calibrate.records(aim())
    assert calibrate.late(aim()) == (aim(), ())
    entered = run(at(Row.WATER)(), SCAN).menu
    assert entered is not None
    assert entered.page is Page.WATER
