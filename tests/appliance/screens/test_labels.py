"""No label beside a key is ever cut: every label with every value that can stand in it, by the width it is drawn with."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

import moderngl
import pytest

from appliance.machine.words import Label, Language, Text
from appliance.scan.exposure import Span, ladder
from appliance.screens import theme
from appliance.screens.canvas import Canvas
from appliance.screens.frame import draw_key_labels, room_between
from drivers.api import Key
from tests.appliance.screens.operator.pages import meant

REFRESH_HZ = (24.0, 30.0, 50.0, 60.0, 75.0, 120.0)
GAINS_DB = (0.0, 0.5, 1.0, 3.25, 6.0)


def exposures() -> set[str]:
    """What can stand behind EXPOSE and ADD: every step of every instrument's ladder."""
    steps = (
        step
        for refresh_hz, gain_db in product(REFRESH_HZ, GAINS_DB)
        for step in ladder(refresh_hz, 0, gain_db, Span(2.0, 16.0, 24.0))
    )
    return {step.label for step in steps}


def words() -> dict[Key, set[Label]]:
    """Every label of each key."""
    found: dict[Key, set[Label]] = {key: set() for key in Key}
    for by_key in meant().values():
        for key, labels in by_key.items():
            found[key] |= set(labels)
    found[Key.BACK].add(Text.SEEN)
    gains = {label.partition(" +")[2] for label in exposures()} - {""}
    found[Key.DOWN] |= {(verb, label) for verb, label in product((Text.EXPOSE, Text.HOLD_ADD), exposures())}
    found[Key.DOWN] |= {(Text.GAIN, gain) for gain in gains}
    # Stand-ins carry the labels of the keys that are stuck.
    found[Key.UP] |= found[Key.SCAN]
    found[Key.DOWN] |= found[Key.BACK]
    return found


@pytest.fixture(scope="module")
def canvas(context: moderngl.Context) -> Iterator[Canvas]:
    with context:
        made = Canvas(context, (800, 480))
        yield made
        made.close()


@pytest.mark.parametrize("language", list(Language))
def test_every_label_with_every_value_is_whole_large_enough_and_within_its_own_field(
    context: moderngl.Context, canvas: Canvas, language: Language
) -> None:
    with context:
        for key, labels in words().items():
            for label in labels:
                canvas.begin(theme.INK)
                draw_key_labels(canvas, {key: label}, language)
                left, right = room_between(canvas, {key: label}, language, theme.KEY_CORNERS[key].value[1])
                drawn = canvas.written
                assert "…" not in "".join(line.words for line in drawn), label
                assert not any(line.cut for line in drawn), label
                assert all(line.size >= theme.CAPTION for line in drawn), label
                assert all(line.left >= 0 and line.right <= canvas.width for line in drawn), label
                assert all(line.right <= left or line.left >= right for line in drawn), label
                assert all(line.top >= canvas.height - 62 or line.bottom <= 62 for line in drawn), label
                assert not any(min(a.bottom, b.bottom) - max(a.top, b.top) > 0.5 for a, b in combinations(drawn, 2)), (
                    label
                )


@pytest.mark.parametrize("language", list(Language))
def test_two_labels_side_by_side_leave_room_between_them_for_a_scale(
    context: moderngl.Context, canvas: Canvas, language: Language
) -> None:
    found = words()
    with context:
        widths = {
            key: {label: room_between(canvas, {key: label}, language, bottom=True) for label in found[key]}
            for key in (Key.DOWN, Key.BACK)
        }
    left = max(room[0] for room in widths[Key.DOWN].values())
    right = min(room[1] for room in widths[Key.BACK].values())
    assert right - left > 260.0


@pytest.mark.parametrize(
    ("language", "lines"),
    [(Language.ENGLISH, ["EXPOSE", "16 ms +12 dB"]), (Language.GERMAN, ["BELICHTEN", "16 ms +12 dB"])],
)
def test_the_longest_exposure_stands_on_two_lines(
    context: moderngl.Context, canvas: Canvas, language: Language, lines: list[str]
) -> None:
    with context:
        canvas.begin(theme.INK)
        draw_key_labels(canvas, {Key.DOWN: (Text.EXPOSE, "16 ms +12 dB")}, language)
        assert [line.words for line in canvas.written] == lines
