"""Every screen and every alert looks as it did when somebody looked at it and kept its picture."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import pytest

from appliance.machine.words import Language
from appliance.scan.fault import FaultCode
from appliance.screens.canvas import Canvas
from appliance.screens.theme import Colour
from appliance.screens.views import AnyView
from tests.appliance.screens.golden import palette
from tests.appliance.screens.golden.compare import compare
from tests.appliance.screens.golden.draw import EVERY, FOLDER, Golden, Studio, studio
from tests.appliance.screens.golden.page import PAGE, page
from tests.appliance.screens.golden.scenes import ALERTS, SCENES

AGAIN = "look at it; if it is meant so: ./dev run python -m tests.appliance.screens.golden"
LOOKED_AT = ("aim", "menu", "review-moved", "calibrate-bar", "self-test-failed")


@pytest.fixture(scope="module")
def made(context: moderngl.Context) -> Iterator[Studio]:
    with studio(context) as opened:
        yield opened


@pytest.mark.parametrize("golden", EVERY, ids=lambda golden: golden.path.stem)
def test_it_looks_as_it_should(made: Studio, golden: Golden) -> None:
    difference = compare(made.draw(golden), palette.read(golden.path))
    assert difference.same, f"{golden.path.name}: {difference}; {AGAIN}"


def test_every_screen_and_every_alert_has_a_picture_and_none_is_left_over() -> None:
    assert {type(scene.view) for scene in SCENES.values()} == set(AnyView.__args__)
    assert set(ALERTS) == {code.value for code in FaultCode}
    assert {path.name for path in FOLDER.glob("*.png")} == {golden.path.name for golden in EVERY}


def test_the_pictures_stay_small() -> None:
    assert sum(path.stat().st_size for path in FOLDER.glob("*.png")) < 3.2e6


def test_the_page_shows_them_all() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), AGAIN


# ------------------------------------------------------------------------ what the comparison tells apart


@pytest.mark.parametrize("name", LOOKED_AT)
def test_no_word_can_be_missing(made: Studio, name: str) -> None:
    golden = Golden(name, Language.ENGLISH, alert=False)
    kept = palette.read(golden.path)
    picture = made.draw(golden)
    for line in list(made.painter.canvas.written):
        without = picture.copy()
        top, bottom, left, right = int(line.top), int(line.bottom) + 1, int(line.left), int(line.right) + 1
        without[top:bottom, left:right] = picture[max(0, top - 2), max(0, left - 1)]
        assert not compare(without, kept).same, line.words


@pytest.mark.parametrize("name", LOOKED_AT)
def test_nothing_can_move_by_four_pixels(made: Studio, name: str) -> None:
    golden = Golden(name, Language.ENGLISH, alert=False)
    picture = made.draw(golden)
    for axis in (0, 1):
        assert not compare(np.roll(picture, 4, axis), palette.read(golden.path)).same


def test_another_number_word_or_colour_is_noticed(made: Studio) -> None:
    scene = SCENES["aim"]
    kept = palette.read(Golden("aim", Language.ENGLISH, alert=False).path)
    for other in (
        {"scans_taken": 13},
        {"exposure": "11 ms"},
        {"scan_allowed": False},
        {"gauge": None},
        {"water": None},
    ):
        made.painter.language = Language.ENGLISH
        assert not compare(made.painter.draw(replace(scene.view, **other), scene.time_s), kept).same, other


@pytest.mark.parametrize("name", LOOKED_AT)
def test_another_rasteriser_of_fonts_passes(made: Studio, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that sets each line up to a pixel elsewhere, and letters fainter."""
    stamp, chance = Canvas._stamp, random.Random(name)

    def elsewhere(self: Canvas, line: object, left: int, top: int, colour: Colour) -> None:
        shift = chance.choice((-1, 0, 1)), chance.choice((-1, 0, 1))
        stamp(self, line, left + shift[0], top + shift[1], colour.faded(0.93))  # type: ignore[arg-type]

    monkeypatch.setattr(Canvas, "_stamp", elsewhere)
    golden = Golden(name, Language.ENGLISH, alert=False)
    assert compare(made.draw(golden), palette.read(golden.path)).same


def test_a_picture_file_gives_back_its_colours(tmp_path: Path) -> None:
    few = np.zeros((5, 7, 3), np.uint8)
    few[1:3, 2:6] = (200, 10, 30)
    path = tmp_path / "few.png"
    palette.write(path, few)
    np.testing.assert_array_equal(palette.read(path), few)
