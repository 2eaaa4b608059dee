"""The operator's papers say what the instrument does, and the card can be read."""

from __future__ import annotations

from itertools import combinations

import moderngl
import pytest

from appliance.machine.words import Language, Text
from appliance.scan.fault import FaultCode
from appliance.screens import theme
from appliance.screens.canvas import Canvas
from tests.appliance.screens.golden import palette
from tests.appliance.screens.golden.compare import compare
from tests.appliance.screens.golden.draw import Golden
from tests.appliance.screens.operator import card
from tests.appliance.screens.operator.__main__ import FOLDER, texts
from tests.appliance.screens.operator.meanings import MEANINGS
from tests.appliance.screens.operator.pages import COMMAND, meant

NAMES = ("README.md", *(f"{page}.{language.value}.md" for page in ("alarms", "keys") for language in Language))


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_not_drifted(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == texts()[name], f"make it again: {COMMAND}"


def test_every_alert_has_a_meaning_in_both_languages() -> None:
    assert set(MEANINGS) == set(FaultCode)
    assert all(english and german and english != german for english, german in MEANINGS.values())


def test_every_label_of_every_state_is_in_the_table_of_texts() -> None:
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
    aim = palette.read(Golden("aim", language, alert=False).path)
    drawn = card.draw_card(context, aim, language)
    lines = kept[0].written
    assert len(lines) > 20
    assert not [line for line in lines if line.cut or line.size < theme.CAPTION]
    assert not [line for line in lines if line.right > kept[0].width or line.bottom > kept[0].height]
    assert not [
        (a.words, b.words)
        for a, b in combinations(lines, 2)
        if min(a.right, b.right) > max(a.left, b.left) and min(a.bottom, b.bottom) > max(a.top, b.top)
    ]
    assert compare(drawn, palette.read(FOLDER / f"dive-card.{language.value}.png")).same, f"make it again: {COMMAND}"
