"""Which keys do what, and that a key of the pad is let go exactly when nothing holds it any more."""

from __future__ import annotations

import pytest

from hw_sim.window.keyboard import HELP, MEANING, QUIT, Keyboard, PadChange


@pytest.mark.parametrize(
    ("name", "key"), [("s", "scan"), ("enter", "scan"), ("b", "back"), ("backspace", "back"), ("up", "up")]
)
def test_a_key_presses_and_lets_go(name: str, key: str) -> None:
    keyboard = Keyboard()
    assert keyboard.change(name, True) == PadChange(key, True)
    assert keyboard.change(name, False) == PadChange(key, False)


def test_two_keys_of_one_meaning_hold_it_together() -> None:
    keyboard = Keyboard()
    changes = [keyboard.change(*c) for c in (("s", True), ("enter", True), ("s", False), ("b", True), ("enter", False))]
    assert changes == [PadChange("scan", True), None, None, PadChange("back", True), PadChange("scan", False)]


@pytest.mark.parametrize("name", ["x", "", "q", "escape"])
def test_other_keys_touch_nothing(name: str) -> None:
    assert Keyboard().change(name, True) is None
    assert Keyboard().change(name, False) is None


def test_a_release_without_a_press_is_nothing() -> None:
    """The window gets the keyboard's focus while a key is already down."""
    assert Keyboard().change("s", False) is None


def test_the_title_names_every_key() -> None:
    named = HELP.lower().replace("esc", "escape").replace("↑", "up").replace("↓", "down").replace(":", " ")
    assert set(MEANING) <= set(named.replace(",", " ").split())
    assert {"scan", "back", "up", "down", QUIT} == set(MEANING.values())
