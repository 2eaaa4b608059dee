"""What was sealed comes back, whatever its layout; anything else is refused with the file, the key, the value, the range and the remedy."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import pytest

from appliance.base.sealed_file import FINITE, LEFT_OUT, Among, ContentError, SealedFile, Within
from tests.support.sealing import opened, sealed


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, slots=True)
class Lamp:
    """Something with a value of each kind."""

    name: str
    power_w: Annotated[float, Within(0.5, 900.0)]
    colour: Colour = Colour.RED
    spot_mm: tuple[float, float] = (0.0, 1.0)
    hours: Annotated[int, Within(0, math.inf, integers_only=True)] | None = field(default=None, metadata=LEFT_OUT)
    volts: Annotated[int, Among((12, 24))] = 12
    drift: Annotated[float, FINITE] = 0.0
    note: str | None = None

    def __post_init__(self) -> None:
        if self.spot_mm[0] > self.spot_mm[1]:
            raise ValueError(f"spot_mm is {self.spot_mm}; allowed: the smaller first")


LAMP = Lamp("µ", 1.5)
FILE = SealedFile(Lamp, schema=3, max_bytes=1000, what="lamp", remedy="buy another")
CONTENT: dict[str, Any] = {
    "schema": 3, "name": "µ", "power_w": 1.5, "colour": "red", "spot_mm": [0.0, 1.0], "volts": 12, "drift": 0.0, "note": None,
}  # fmt: skip


@pytest.mark.parametrize("indent", [None, 1, 2])
def test_what_was_sealed_comes_back_whatever_its_layout(indent: int | None, tmp_path: Path) -> None:
    assert replace(FILE, indent=indent).encode(LAMP) == sealed(CONTENT, indent)
    (tmp_path / "lamp.json").write_bytes(sealed(CONTENT, indent))
    assert FILE.load(tmp_path / "lamp.json") == LAMP
    assert FILE.load(tmp_path / "none.json") is None
    lit = replace(LAMP, hours=7, note="x", colour=Colour.BLUE)
    assert opened(FILE.encode(lit)) == {**CONTENT, "hours": 7, "note": "x", "colour": "blue"}
    assert FILE.decode(FILE.encode(lit), "here") == lit
    assert FILE.decode(sealed({**CONTENT, "power_w": 2, "volts": 24, "later": [1]}), "here") == replace(
        LAMP, power_w=2.0, volts=24
    )


def test_a_file_without_a_checksum_keeps_the_order_of_its_fields() -> None:
    bare = replace(FILE, checksum=False, indent=1)
    assert list(json.loads(bare.encode(LAMP))) == list(CONTENT)
    assert bare.decode(json.dumps(CONTENT).encode(), "here") == LAMP


def test_a_file_is_of_who_it_says() -> None:
    mine = {"owner": "me", "of": [1, 2]}
    data = FILE.encode(LAMP, mine)
    assert opened(data) == CONTENT | mine
    assert FILE.decode(data, "here", mine) == LAMP
    for owner in ({"owner": "you"}, {**mine, "of": [1]}, {**mine, "more": 1}):
        with pytest.raises(
            ContentError,
            match=r"^here: (owner 'me'; allowed: 'you'|of \[1, 2\]; allowed: \[1\]|more None; allowed: 1); buy another$",
        ):
            FILE.decode(data, "here", owner)


WRONG: dict[str, tuple[bytes, str]] = {
    "damage": (sealed(CONTENT).replace(b"1.5", b"1.6"), "changed or damaged"),
    "end": (sealed(CONTENT)[:-9], "not readable as JSON"),
    "no checksum": (b'{"a": 1}', "changed or damaged"),
    "list": (b"[]", "a JSON object was expected, not list"),
    "depth": (b"[" * 900, "not readable as JSON"),
    "no text": (b"\xff", "not readable as JSON"),
    "not finite": (b'{"a": NaN}', "NaN"),
    "no float": (b'{"a": 1e999}', "1e999"),
    "size": (b" " * 1001, "1001 bytes; allowed: at most 1000"),
    "schema": (sealed({**CONTENT, "schema": 4}), "schema 4; allowed: 3, which this version reads"),
    "no schema": (sealed({"name": "µ"}), "schema None"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_bytes_that_are_no_such_file_are_refused_with_the_reason(wrong: str, tmp_path: Path) -> None:
    data, reason = WRONG[wrong]
    with pytest.raises(ContentError) as refused:
        FILE.decode(data, "here")
    assert str(refused.value).startswith(f"here: {refused.value.value}")
    assert str(refused.value).endswith("; buy another")
    assert reason in str(refused.value)
    with pytest.raises(ContentError, match=f"^lamp {tmp_path}: cannot be read .*; buy another$"):
        FILE.load(tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"power_w": 0.4}, "power_w is 0.4; allowed: 0.5..900"), ({"power_w": True}, "power_w is True; allowed: 0.5..900"),
        ({"power_w": None}, "power_w is None; allowed: 0.5..900"), ({"power_w": "2"}, "power_w is '2'; allowed: 0.5..900"),
        ({"hours": -1}, "hours is -1; allowed: whole numbers from 0"), ({"hours": 1.0}, "hours is 1.0; allowed: whole numbers from 0"),
        ({"volts": 13}, "volts is 13; allowed: 12 or 24"), ({"volts": 24.0}, "volts is 24.0; allowed: 12 or 24"),
        ({"hours": None}, "hours is None; allowed: whole numbers from 0"), ({"drift": False}, "drift is False; allowed: finite numbers"),
        ({"drift": 10**400}, "drift is 1000"), ({"colour": "green"}, "colour is 'green'; allowed: 'red' or 'blue'"),
        ({"spot_mm": [1.0]}, "spot_mm is [1.0]; allowed: a list of 2"), ({"spot_mm": "12"}, "spot_mm is '12'; allowed: a list"),
        ({"spot_mm": [0.0, "b"]}, "spot_mm.1 is 'b'; allowed: a number"), ({"spot_mm": [2, 1]}, "spot_mm is (2.0, 1.0); allowed: the smaller first"),
        ({"name": 7}, "name is 7; allowed: a text"), ({"note": []}, "note is []; allowed: a text"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_is_named_with_what_is_allowed(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ContentError) as refused:
        FILE.decode(sealed(CONTENT | change), "here")
    assert str(refused.value).startswith(f"here: {said}")
    assert (refused.value.what, refused.value.remedy) == ("here", "buy another")


def test_a_refusal_comes_whole_from_another_process() -> None:
    told = ContentError("here", "hours is -1", "whole numbers from 0", "buy another")
    again = pickle.loads(pickle.dumps(told))
    assert (
        (str(again), again.allowed)
        == (str(told), told.allowed)
        == ("here: hours is -1; allowed: whole numbers from 0; buy another", told.allowed)
    )


def test_a_key_that_is_missing_and_a_content_that_cannot_be_are_named() -> None:
    with pytest.raises(ContentError, match=r"^here: name is missing; buy another$"):
        FILE.decode(sealed({key: value for key, value in CONTENT.items() if key != "name"}), "here")

    def never(lamp: Lamp) -> None:
        raise ValueError(f"{lamp.name} is too bright")

    with pytest.raises(ContentError, match=r"^here: µ is too bright; buy another$"):
        replace(FILE, check=never).decode(sealed(CONTENT), "here")
