"""Every screen, every alert and the operator's papers look as they did when somebody looked at them and kept them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import moderngl
import numpy as np
import pytest

from appliance.machine.words import Language, Text
from appliance.scan.fault import FaultCode
from appliance.screens import theme
from appliance.screens.canvas import Canvas
from appliance.screens.views import AnyView
from tests.appliance.screens.golden import palette
from tests.appliance.screens.golden.compare import compare
from tests.appliance.screens.golden.draw import EVERY, FOLDER, Golden, Studio, studio
from tests.appliance.screens.golden.page import PAGE, page
from tests.appliance.screens.golden.scenes import ALERTS, SCENES
from tests.appliance.screens.operator import card
from tests.appliance.screens.operator.__main__ import FOLDER as PAPERS
from tests.appliance.screens.operator.__main__ import texts
from tests.appliance.screens.operator.meanings import MEANINGS
from tests.appliance.screens.operator.pages import COMMAND, meant
from tests.appliance.screens.test_legible import overlap

AGAIN = "look at it; if it is meant so: ./dev run python -m tests.appliance.screens.golden"
AIM = Golden("aim", Language.ENGLISH, alert=False)


@pytest.fixture(scope="module")
def made(context: moderngl.Context) -> Iterator[Studio]:
    with studio(context) as opened:
        yield opened


@pytest.mark.parametrize("golden", EVERY, ids=lambda golden: golden.path.stem)
def test_it_looks_as_it_should(made: Studio, golden: Golden) -> None:
    difference = compare(made.draw(golden), palette.read(golden.path))
    assert difference.same, f"{golden.path.name}: {difference}; {AGAIN}"


def test_every_screen_and_every_alert_has_a_picture_and_a_place_on_the_page_and_none_is_left_over() -> None:
    assert {type(scene.view) for scene in SCENES.values()} == set(AnyView.__args__)
    assert set(ALERTS) == {code.value for code in FaultCode}
    assert {path.name for path in FOLDER.glob("*.png")} == {golden.path.name for golden in EVERY}
    assert sum(path.stat().st_size for path in FOLDER.glob("*.png")) < 3.2e6
    assert PAGE.read_text(encoding="utf-8") == page(), AGAIN


def test_another_word_number_colour_or_place_is_noticed(made: Studio) -> None:
    kept, picture = palette.read(AIM.path), made.draw(AIM)
    for line in list(made.painter.canvas.written):
        without = picture.copy()
        top, bottom, left, right = int(line.top), int(line.bottom) + 1, int(line.left), int(line.right) + 1
        without[top:bottom, left:right] = picture[max(0, top - 2), max(0, left - 1)]
        assert not compare(without, kept).same, line.words
    for axis in (0, 1):
        assert not compare(np.roll(picture, 4, axis), kept).same
    scene = SCENES["aim"]
    for other in (
        {"scans_taken": 13},
        {"exposure": "11 ms"},
        {"scan_allowed": False},
        {"gauge": None},
        {"water": None},
    ):
        made.painter.language = Language.ENGLISH
        assert not compare(made.painter.draw(replace(scene.view, **other), scene.time_s), kept).same, other


def test_a_picture_file_gives_back_its_colours(tmp_path: Path) -> None:
    few = np.zeros((5, 7, 3), np.uint8)
    few[1:3, 2:6] = (200, 10, 30)
    palette.write(tmp_path / "few.png", few)
    np.testing.assert_array_equal(palette.read(tmp_path / "few.png"), few)


# ---------------------------------------------------------------------------------------------- the operator's papers
def test_the_pages_have_not_drifted_and_every_word_in_them_has_two_languages() -> None:
    found = {name: (PAPERS / name).read_text(encoding="utf-8") == text for name, text in texts().items()}
    assert found == dict.fromkeys(found, True), f"make it again: {COMMAND}"
    assert set(MEANINGS) == set(FaultCode)
    assert all(english and german and english != german for english, german in MEANINGS.values())
    said = {word for by_key in meant().values() for words in by_key.values() for word in words}
    assert len(said) > 15
    assert all(isinstance(word[0] if isinstance(word, tuple) else word, Text) for word in said)


@pytest.mark.parametrize("language", list(Language))
def test_the_card_is_as_it_was_and_all_of_it_can_be_read(
    context: moderngl.Context, language: Language, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Canvas] = []
    begin = Canvas.begin

    def keeping(self: Canvas, ground: theme.Colour) -> None:
        kept.append(self)
        begin(self, ground)

    monkeypatch.setattr(Canvas, "begin", keeping)
    drawn = card.draw_card(context, palette.read(replace(AIM, language=language).path), language)
    lines = kept[0].written
    assert len(lines) > 20
    assert not [line for line in lines if line.cut or line.size < theme.CAPTION]
    assert not [line for line in lines if line.right > kept[0].width or line.bottom > kept[0].height]
    assert not [(a.words, b.words) for a, b in combinations(lines, 2) if overlap(a, b)]
    assert compare(drawn, palette.read(PAPERS / f"dive-card.{language.value}.png")).same, f"make it again: {COMMAND}"
