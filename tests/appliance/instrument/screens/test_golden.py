"""Every screen, every alert and the operator's papers look as they did when somebody looked at them and kept them, and say what the machine does."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import moderngl
import numpy as np
import pytest

from appliance.instrument.machine.alerts import RULES, Severity
from appliance.instrument.machine.states import State
from appliance.instrument.machine.words import Label, Language, Text, worded
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Canvas
from appliance.instrument.screens.frame import alert_text
from appliance.instrument.screens.views import AnyView
from appliance.measure.fault import FaultCode
from appliance.measure.verdict import SPOILS_POINTS, SPOILS_SCAN
from drivers.api import Key
from tests.appliance.instrument.screens.golden import card
from tests.appliance.instrument.screens.golden.pictures import (
    COMMAND,
    EVERY,
    FOLDER,
    Golden,
    Studio,
    compare,
    read,
    studio,
)
from tests.appliance.instrument.screens.golden.scenes import ALERTS, SCENES
from tests.appliance.instrument.screens.test_legible import BOTH, DATA, complaints, moments, overlap

DOCS = Path(__file__).parents[4] / "docs"
AGAIN = f"look at it; if it is meant so: {COMMAND}"
AIM = Golden("aim", Language.ENGLISH, alert=False)


@pytest.fixture(scope="module")
def made(context: moderngl.Context) -> Iterator[Studio]:
    with studio(context) as opened:
        yield opened


@pytest.mark.parametrize("golden", EVERY, ids=lambda golden: golden.path.stem)
def test_it_looks_as_it_should_and_every_word_fits_its_room(made: Studio, golden: Golden) -> None:
    difference = compare(made.draw(golden), read(golden.path))
    assert difference.same, f"{golden.path.name}: {difference}; {AGAIN}"
    if not golden.alert:
        lines, view = list(made.painter.canvas.written), SCENES[golden.name].view
        assert lines or golden.name == "reconstruct"
        assert not complaints(made.painter.canvas, view, lines, may_be_cut=golden.name in DATA)


def test_every_screen_and_every_alert_has_a_picture_and_a_place_on_the_page_and_none_is_left_over() -> None:
    assert {type(scene.view) for scene in SCENES.values()} == set(AnyView.__args__)
    assert set(ALERTS) == {code.value for code in FaultCode}
    there, wanted = {path.name for path in FOLDER.glob("*.png")}, {golden.path.name for golden in EVERY}
    assert there == wanted
    page = (DOCS / "screens.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"/golden/([\w.-]+)\)", page)) == sorted(wanted)
    assert sum(path.stat().st_size for path in FOLDER.glob("*.png")) < 3.2e6


def test_another_word_number_colour_or_place_is_noticed(made: Studio) -> None:
    kept, picture = read(AIM.path), made.draw(AIM)
    for line in list(made.painter.canvas.written):
        without = picture.copy()
        top, bottom, left, right = int(line.top), int(line.bottom) + 1, int(line.left), int(line.right) + 1
        without[top:bottom, left:right] = picture[max(0, top - 2), max(0, left - 1)]
        assert not compare(without, kept).same, line.text
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


def rows(name: str, language: Language) -> dict[str, list[list[str]]]:
    """The cells of each table row of a page, by the heading before it."""
    found: dict[str, list[list[str]]] = defaultdict(list)
    heading = ""
    for line in (card.FOLDER / f"{name}.{language.value}.md").read_text(encoding="utf-8").splitlines():
        heading = line if line.startswith("#") else heading
        if line.startswith("| **") or (name == "keys" and line.startswith("| ")):
            found[heading].append([cell.strip() for cell in line.strip("|").split("|")])
    return found


def effect(code: FaultCode, language: Language) -> str:
    rule = RULES[code]
    said = (
        (rule.forbids_light, "no light", "kein Licht"),
        (rule.blocks_scan, "no scan while it lasts", "kein Scan, solange es dauert"),
        (code in SPOILS_SCAN, "this scan is not used", "dieser Scan wird nicht verwendet"),
        (code in SPOILS_POINTS, "this scan is not called good", "dieser Scan gilt nicht als gut"),
    )
    return ", ".join(german if language is Language.GERMAN else english for holds, english, german in said if holds)


@BOTH
def test_the_list_of_alarms_has_each_with_its_words_and_its_effect_and_a_meaning(language: Language) -> None:
    *by_severity, many = rows("alarms", language).values()
    assert len(by_severity) == len(Severity)
    for severity, found in zip(sorted(Severity, reverse=True), by_severity, strict=True):
        wanted = {
            (*(alert_text(ALERTS[code.value], language)), effect(code, language))
            for code, rule in RULES.items()
            if rule.severity is severity
        }
        assert {(headline.strip("*"), action, what) for headline, _, action, what in found} == wanted
        assert all(len(meaning) > 10 for _, meaning, _, _ in found)
    said = [words for headline, *_ in many for words in re.findall(r"\*\*(.*?)\*\*", headline)]
    way = ((Text.OVERLAP, "25 %"), Text.TURN_BACK), ((Text.OVERLAP, "80 %"), Text.GO_ON), ((Text.OVERLAP, "50 %"), Text.SCAN_NOW)  # fmt: skip
    after: tuple[Label, ...] = ((Text.OVERLAP, "62 %"), (Text.NO_OVERLAP, Text.GO_BACK), Text.OVERLAP_UNSURE)
    aiming = [" · ".join(worded(word, language) for word in words) for words in way]
    assert said == [*(worded(one, language) for one in after), *aiming, worded(Text.TURN_BACK, language)]


@BOTH
def test_the_key_map_has_every_label_of_every_state(language: Language) -> None:
    order = (Key.SCAN, Key.BACK, Key.UP, Key.DOWN)
    meant: dict[str, dict[Key, dict[str, None]]] = defaultdict(lambda: {key: {} for key in Key})
    for row, by_key in moments():
        for key, word in by_key.items():
            assert isinstance(word[0] if isinstance(word, tuple) else word, Text), "in two languages"
            meant[row][key][worded(word, language)] = None
    asked = Text.POWER_OFF_ASKED
    names = {**{state.value: state.value for state in State}, asked.english: asked.in_language(language)}
    wanted = [[name, *(", ".join(meant[row][key]) for key in order)] for row, name in names.items()]
    (found,) = rows("keys", language).values()
    assert found[-len(wanted) :] == wanted


@BOTH
def test_the_card_is_as_it_was_and_all_of_it_can_be_read(
    context: moderngl.Context, language: Language, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Canvas] = []
    begin = Canvas.begin

    def keeping(self: Canvas, ground: theme.Colour) -> None:
        kept.append(self)
        begin(self, ground)

    monkeypatch.setattr(Canvas, "begin", keeping)
    drawn = card.draw_card(context, read(AIM._replace(language=language).path), language)
    lines = kept[0].written
    assert len(lines) > 20
    assert not [line for line in lines if line.cut or line.size < theme.CAPTION]
    assert not [line for line in lines if line.right > kept[0].width or line.bottom > kept[0].height]
    assert not [(a.text, b.text) for a, b in combinations(lines, 2) if overlap(a, b)]
    assert compare(drawn, read(card.path(language))).same, AGAIN
