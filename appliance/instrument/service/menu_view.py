"""Owns the words and values of the menu's rows."""

from __future__ import annotations

from dataclasses import dataclass

import appliance
from appliance.instrument.machine import menu
from appliance.instrument.machine.leading import alerts, on_screen
from appliance.instrument.machine.menu import Row
from appliance.instrument.machine.states import Answer, Machine, Menu, OffQuestion, Page
from appliance.instrument.machine.transfer import Serving
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.screens.views import MenuRow, MenuView


@dataclass(frozen=True, slots=True)
class Facts:
    """The facts that the menu tells about the instrument."""

    serial: str
    calibrated: Label
    """The day of the calibration; or that there never was one."""


TITLES = {Page.MAIN: Text.MENU, Page.WATER: Text.WATER, Page.TRANSFER: Text.TRANSFER, Page.ABOUT: Text.ABOUT}
WORDS = {
    Row.EXPOSURE: Text.EXPOSURE,
    Row.PERIOD: Text.FRINGES,
    Row.WATER: Text.WATER,
    Row.CALIBRATION: Text.CALIBRATE,
    Row.GALLERY: Text.GALLERY,
    Row.OBJECT: Text.OBJECT,
    Row.LANGUAGE: Text.LANGUAGE,
    Row.ABOUT: Text.ABOUT,
    Row.POWER_OFF: Text.POWER_OFF,
    Row.WATER_KIND: Text.WATER_KIND,
    Row.WATER_TEMPERATURE: Text.WATER_TEMPERATURE,
    Row.TRANSFER: Text.TRANSFER,
    Row.TRANSFER_SWITCH: Text.TRANSFER,
    Row.ADDRESS: Text.ADDRESS,
    Row.KEYS: Text.TRANSFER_KEYS,
    Row.VERSION: Text.VERSION,
    Row.SERIAL_NUMBER: Text.SERIAL_NUMBER,
    Row.CALIBRATED: Text.CALIBRATED,
    Row.SALINITY: Text.SALINITY,
    Row.DISK: Text.DISK,
}
LANGUAGES = {"en": Text.ENGLISH, "de": Text.GERMAN}


ANSWERS = {Answer.STAY_ON: Text.STAY_ON, Answer.SWITCH_OFF: Text.SWITCH_OFF}


def question_view(machine: Machine, question: OffQuestion) -> MenuView:
    """Return the question whether to switch off: two answers, on the screen of any state."""
    rows = tuple(MenuRow(ANSWERS[answer]) for answer in Answer)
    selected = list(Answer).index(question.answer)
    # All alerts: the question stands over any state, whose own screen may have kept some of them quiet.
    return MenuView(title=Text.POWER_OFF_ASKED, rows=rows, selected=selected, alerts=alerts(machine))


def menu_view(machine: Machine, facts: Facts | None) -> MenuView:
    """Return the page the diver is on, with what is being changed as it would be."""
    at = machine.menu or Menu()
    rows = tuple(MenuRow(WORDS[row], value_of(row, machine, facts)) for row in menu.ROWS[at.page])
    changing = at.draft is not None
    return MenuView(title=TITLES[at.page], rows=rows, selected=at.row, changing=changing, alerts=on_screen(machine))


FRINGES = {16: Text.FINE, 32: Text.MEDIUM, 64: Text.COARSE_FRINGES}


SERVING = {Serving.STARTING: Text.STARTING, Serving.ON: Text.ON, Serving.FAILED: Text.TRANSFER_FAILED}


def value_of(row: Row, machine: Machine, facts: Facts | None) -> Label:
    """Return what is chosen; while it is being changed, what it would be."""
    chosen = menu.shown(machine)
    match row:
        case Row.EXPOSURE:
            value: Label = chosen.exposure.label
        case Row.PERIOD:
            value = FRINGES.get(chosen.period_px, f"{chosen.period_px} px")
        case Row.WATER:
            value = (Text.SALT if chosen.salt else Text.FRESH, f"{chosen.water_c:g} °C")
        case Row.WATER_KIND:
            value = Text.SALT if chosen.salt else Text.FRESH
        case Row.WATER_TEMPERATURE:
            value = f"{chosen.water_c:g} °C"
        case Row.OBJECT:
            number = chosen.object
            began = number is not None and number > machine.choices.objects
            value = Text.NO_OBJECT if number is None else (str(number), Text.NEW) if began else str(number)
        case Row.LANGUAGE:
            value = LANGUAGES.get(chosen.language, Text.ENGLISH)
        case Row.TRANSFER:
            value = Text.ON if chosen.transfer else Text.OFF
        case Row.TRANSFER_SWITCH:
            begun = chosen.transfer and machine.choices.transfer
            word = SERVING[machine.transfer.serving] if begun else Text.ON
            value = word if chosen.transfer else Text.OFF
        case Row.ADDRESS if machine.transfer.serving is Serving.ON:
            value = machine.transfer.address or Text.NO_NETWORK
        case Row.KEYS if machine.transfer.serving is Serving.ON and machine.transfer.keys is not None:
            value = str(machine.transfer.keys) if machine.transfer.keys else Text.PLUG_STICK_IN
        case Row.VERSION:
            value = appliance.__version__
        case Row.DISK:
            left = "?" if machine.scans_left is None else str(machine.scans_left)
            value = (str(machine.scans), Text.TAKEN, f"· {left}", Text.LEFT_OVER)
        case Row.SERIAL_NUMBER if facts is not None:
            value = facts.serial
        case Row.CALIBRATED if facts is not None:
            value = facts.calibrated
        case Row.SALINITY:
            value = f"{chosen.salinity_psu:g} psu"
        case _:
            value = ""
    return value
