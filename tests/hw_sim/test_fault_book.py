"""The world says which faults it has, and refuses all others."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hw_sim.faults import KINDS, FaultBook, FaultSyntaxError, parse
from tests.hw_sim.conftest import HandTime

MANUAL = Path(__file__).parents[2] / "docs" / "protocols" / "world.md"


def sentences_of_the_manual() -> list[str]:
    """The first column of the table, every alternative of a row spelt out."""
    chapter = MANUAL.read_text().split("## Fault sentences")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", chapter, re.MULTILINE)
    found = []
    for row in rows:
        whole = re.findall(r"`([^`]+)`", row)
        if not whole or not re.match(r"(camera|projector|graphics|board|laser|keypad|key|sensor|leak)\b", whole[0]):
            continue
        first = whole[0].replace("[", "").replace("]", "").split()
        for text in whole:
            words = text.replace("[", "").replace("]", "").split()
            if words[0].startswith("how="):
                words = [*first[:2], *words]
            elif len(words) < 2 or "=" in words[1]:
                words = [first[0], *words]
            found.append(" ".join(words))
    return found


@pytest.mark.parametrize("sentence", sentences_of_the_manual())
def test_every_sentence_of_the_manual_is_understood(sentence: str) -> None:
    assert parse(sentence).sentence == sentence


def test_the_manual_lists_every_fault() -> None:
    documented = {(parse(s).component.split(".")[0], parse(s).verb) for s in sentences_of_the_manual()}
    assert documented == set(KINDS)


@pytest.mark.parametrize(
    ("sentence", "said"),
    [
        ("camera.left explode", "'camera.left explode' is not supported; supported: camera.left|right intermittent"),
        ("camera.middle off", "'camera.middle off' is not supported"),
        ("camera off", "'camera off' is not supported"),
        ("leak", "a component and a verb are needed"),
        ("camera.left wrong frame=9", "how=None is not supported; supported: how=repeat or how=swap"),
        ("camera.left off how=far", "how=far is not supported; supported: no how"),
        ("camera.left intermittent frame=nine", "frame=nine is not a number"),
        ("camera.left intermittent frame=-1", "frame=-1; allowed are 0 and more"),
        ("camera.left off at_s=inf", "at_s=inf; allowed are 0 and more, below 1e+09"),
        ("camera.left off for_s=1e300", "for_s=1e300; allowed are 0 and more, below 1e+09"),
        ("camera.left intermittent frames=9", "'frames=9' is not understood"),
        ("camera.left off count=3", "it lasts, so it has no count"),
        ("camera.left off amount=3", "it takes no amount"),
        ("sensor.TPROJ wrong", "amount= is needed"),
    ],
)
def test_a_wrong_sentence_is_refused_with_what_is_allowed(sentence: str, said: str) -> None:
    with pytest.raises(FaultSyntaxError) as caught:
        parse(sentence)
    assert said in str(caught.value)
    assert sentence in str(caught.value)


def test_a_lasting_fault_begins_and_ends_when_it_says(hand_time: HandTime, faults: FaultBook) -> None:
    with hand_time.condition:
        faults.add("keypad off at_s=1 for_s=2")
    assert faults.active("keypad", "off") is None
    hand_time.run(1.0)
    assert faults.active("keypad", "off") is not None
    hand_time.run(1.9)
    assert faults.active("keypad", "off") is not None
    hand_time.run(0.1)
    assert faults.active("keypad", "off") is None


def test_a_lasting_fault_with_a_frame_waits_for_it(hand_time: HandTime, faults: FaultBook) -> None:
    with hand_time.condition:
        faults.add("camera.left off frame=3 for_s=1")
        faults.reach(2, hand_time.now_ns())
        assert faults.active("camera.left", "off") is None
        hand_time.run(5.0)
        faults.reach(3, hand_time.now_ns())
    assert faults.active("camera.left", "off") is not None
    assert faults.active("camera.right", "off") is None
    hand_time.run(1.0)
    assert faults.active("camera.left", "off") is None, "for_s counts from the frame"


def test_a_frame_is_struck_once_and_a_count_is_kept(hand_time: HandTime, faults: FaultBook) -> None:
    with hand_time.condition:
        faults.add("camera.left intermittent frame=9")
        faults.add("camera.right intermittent count=2")
    assert faults.strike("camera.left", "intermittent", frame=8) is None
    assert faults.strike("camera.left", "intermittent", frame=None) is None
    assert faults.strike("camera.left", "intermittent", frame=9) is not None
    assert faults.strike("camera.left", "intermittent", frame=9) is None, "the next sequence is whole again"
    assert [faults.strike("camera.right", "intermittent", frame=k) is not None for k in range(4)] == [
        *(True, True, False, False)
    ]


def test_repair_ends_everything(hand_time: HandTime, faults: FaultBook) -> None:
    with hand_time.condition:
        faults.add("board off")
        faults.add("leak wrong")
        faults.clear()
    assert faults.active("board", "off") is None
    assert faults.active("leak", "wrong") is None
