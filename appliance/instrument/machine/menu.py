"""The menu: its pages, their rows in order, and the effect of each key on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from types import MappingProxyType

from appliance.instrument.machine import asking, calibrate, choices, gallery
from appliance.instrument.machine.choices import Choices
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Machine, Menu, Page, State
from appliance.instrument.machine.words import Text
from drivers.api import Key


class Row(Enum):
    """Subject of a row."""

    EXPOSURE = "EXPOSURE"
    PERIOD = "PERIOD"
    WATER = "WATER"
    CALIBRATION = "CALIBRATION"
    OBJECT = "OBJECT"
    GALLERY = "GALLERY"
    TRANSFER = "TRANSFER"
    LANGUAGE = "LANGUAGE"
    ABOUT = "ABOUT"
    POWER_OFF = "POWER OFF"

    WATER_KIND = "WATER KIND"
    WATER_TEMPERATURE = "WATER TEMPERATURE"

    TRANSFER_SWITCH = "TRANSFER SWITCH"
    ADDRESS = "ADDRESS"
    KEYS = "KEYS"

    VERSION = "VERSION"
    SERIAL_NUMBER = "SERIAL NUMBER"
    CALIBRATED = "CALIBRATED"
    SALINITY = "SALINITY"
    DISK = "DISK"


ROWS: Mapping[Page, tuple[Row, ...]] = MappingProxyType(
    {
        Page.MAIN: (
            *(
                Row.EXPOSURE,
                Row.PERIOD,
                Row.WATER,
                Row.CALIBRATION,
                Row.OBJECT,
                Row.GALLERY,
                Row.TRANSFER,
                Row.LANGUAGE,
                Row.ABOUT,
                Row.POWER_OFF,
            ),
        ),
        Page.WATER: (Row.WATER_KIND, Row.WATER_TEMPERATURE),
        Page.TRANSFER: (Row.TRANSFER_SWITCH, Row.ADDRESS, Row.KEYS),
        Page.ABOUT: (Row.VERSION, Row.SERIAL_NUMBER, Row.CALIBRATED, Row.SALINITY, Row.DISK),
    }
)
PAGES = {Row.WATER: Page.WATER, Row.TRANSFER: Page.TRANSFER, Row.ABOUT: Page.ABOUT}
"""Rows of the main page that lead to another page."""
VALUES = (
    *(Row.EXPOSURE, Row.PERIOD, Row.WATER_KIND, Row.WATER_TEMPERATURE, Row.OBJECT, Row.LANGUAGE),
    Row.TRANSFER_SWITCH,
)
"""Rows whose value is changed with UP and DOWN after SCAN."""


READ_ONLY = (*ROWS[Page.ABOUT], Row.ADDRESS, Row.KEYS)
"""Rows that only show a value: SCAN has no effect on them."""


def open_menu(machine: Machine) -> Result:
    """Open the menu from AIM."""
    return replace(enter(machine, State.MENU), menu=Menu()), ()


def row_of(menu: Menu) -> Row:
    """Return the selected row."""
    return ROWS[menu.page][menu.row]


def shown(machine: Machine) -> Choices:
    """Return the choices as the menu shows them: with the value that is being changed."""
    draft = machine.menu.draft if machine.menu is not None else None
    return draft or machine.choices


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a key: UP and DOWN select or change, SCAN opens or applies, BACK leaves or discards."""
    menu = machine.menu
    if menu is None:  # cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    match key:
        case Key.BACK if menu.draft is not None:
            return _with_menu(machine, replace(menu, draft=None)), ()
        case Key.BACK if menu.page is not Page.MAIN:
            # Back to the row that opened this page: with gloves each row is a press.
            back = next(row for row, page in PAGES.items() if page is menu.page)
            return _with_menu(machine, Menu(row=ROWS[Page.MAIN].index(back))), ()
        case Key.BACK:
            return enter(machine, State.AIM), ()
        case Key.SCAN if menu.draft is not None:
            # No effect here: `step._settle` compares the choices before and after each step, so that none can be
            # forgotten.
            return _with_menu(replace(machine, choices=menu.draft), replace(menu, draft=None)), ()
        case Key.SCAN:
            return _chosen(machine, menu)
        case _ if menu.draft is not None:
            return _with_menu(machine, replace(menu, draft=_changed(machine, menu, menu.draft, key))), ()
        case _:
            return _with_menu(machine, replace(menu, row=_next(menu, key))), ()


def may_move(machine: Machine, key: Key) -> bool:
    """Return True if UP or DOWN would change the selection or the value."""
    menu = machine.menu
    if menu is None:
        return False
    if menu.draft is not None:
        return _changed(machine, menu, menu.draft, key) != menu.draft
    return _next(menu, key) != menu.row


def may_choose(machine: Machine) -> bool:
    """Return True if SCAN has an effect on the selected row."""
    menu = machine.menu
    return menu is not None and (menu.draft is not None or row_of(menu) not in READ_ONLY)


def verb(machine: Machine) -> Text:
    """Return the label of SCAN on the selected row."""
    row = row_of(machine.menu) if machine.menu is not None else None
    return Text.CHANGE if row in VALUES else Text.OPEN


def _with_menu(machine: Machine, menu: Menu) -> Machine:
    return replace(machine, menu=menu)


def _next(menu: Menu, key: Key) -> int:
    """Return the index of the next row.

    It stops at the ends, so that cold hands find the first and the last row without looking.
    """
    return min(max(menu.row + (1 if key is Key.DOWN else -1), 0), len(ROWS[menu.page]) - 1)


def _chosen(machine: Machine, menu: Menu) -> Result:
    row = row_of(menu)
    if row in VALUES:
        return _with_menu(machine, replace(menu, draft=machine.choices)), ()
    if row in PAGES:
        return _with_menu(machine, Menu(PAGES[row])), ()
    match row:
        case Row.CALIBRATION:
            return calibrate.begin(machine)
        case Row.GALLERY:
            return gallery.open_gallery(machine)
        case Row.POWER_OFF:
            return asking.ask(machine), ()
        case _:
            return machine, ()


def _changed(machine: Machine, menu: Menu, draft: Choices, key: Key) -> Choices:
    """Return the draft one step further; UP is more."""
    steps = 1 if key is Key.UP else -1
    offers = machine.settings.offers
    match row_of(menu):
        case Row.EXPOSURE:
            return choices.another_exposure(draft, offers, steps)
        case Row.PERIOD:
            return choices.another_period(draft, offers, steps)
        case Row.WATER_KIND:
            return choices.other_water(draft, offers)
        case Row.WATER_TEMPERATURE:
            return choices.warmer(draft, steps)
        case Row.OBJECT:
            return choices.another_object(draft, machine.choices, machine.objects_used, steps)
        case Row.TRANSFER_SWITCH:
            return choices.other_transfer(draft, steps)
        case Row.LANGUAGE:
            return choices.another_language(draft, steps)
        case _:
            return draft
