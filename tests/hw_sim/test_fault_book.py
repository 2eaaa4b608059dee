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


def test_every_sentence_of_the_manual_is_understood_and_every_fault_is_in_it() -> None:
    sentences = sentences_of_the_manual()
    assert [parse(sentence).sentence for sentence in sentences] == sentences
    assert {(parse(s).component.split(".")[0], parse(s).verb) for s in sentences} == set(KINDS)


@pytest.mark.parametrize(
    ("sentence", "named"),
    [
        ("camera.left explode", "supported: camera.left|right intermittent"),
        ("camera.middle off", "not supported"),
        ("leak", "a component and a verb"),
        ("camera.left wrong frame=9", "how=repeat or how=swap"),
        ("camera.left off how=far", "no how"),
        ("camera.left intermittent frame=nine", "frame=nine"),
        ("camera.left intermittent frame=-1", "0 and more"),
        ("camera.left off at_s=inf", "below 1e+09"),
        ("camera.left intermittent frames=9", "'frames=9'"),
        ("camera.left off count=3", "no count"),
        ("camera.left off amount=3", "no amount"),
        ("sensor.TPROJ wrong", "amount= is needed"),
    ],
)
def test_a_wrong_sentence_is_refused_with_what_is_allowed(sentence: str, named: str) -> None:
    with pytest.raises(FaultSyntaxError, match=re.escape(named)) as caught:
        parse(sentence)
    assert sentence in str(caught.value)


def test_a_lasting_fault_begins_and_ends_when_it_says_and_tells_the_devices(hand_time: HandTime) -> None:
    told_ns: list[int] = []
    faults = FaultBook(hand_time.now_ns, hand_time.at, told_ns.append)
    begun_ns = hand_time.now_ns()

    def broken() -> list[bool]:
        return [faults.active(part, "off") is not None for part in ("keypad", "camera.left", "camera.right")]

    with hand_time.condition:
        faults.add("keypad off at_s=1 for_s=2")
        faults.add("camera.left off frame=3 for_s=1")
        faults.reach(2, hand_time.now_ns())
    assert broken() == [False, False, False]
    hand_time.run(1.0)
    assert broken() == [True, False, False]
    with hand_time.condition:
        faults.reach(3, hand_time.now_ns())
    hand_time.run(0.9)
    assert broken() == [True, True, False]
    hand_time.run(0.1)
    assert broken() == [True, False, False], "for_s counts from the frame"
    hand_time.run(1.0)
    assert broken() == [False, False, False]
    assert [(t - begun_ns) / 1e9 for t in told_ns][-4:] == [1.0, 1.0, 2.0, 3.0], "they do not poll"


def test_a_frame_is_struck_once_and_a_count_is_kept_until_all_is_repaired(
    hand_time: HandTime, faults: FaultBook
) -> None:
    with hand_time.condition:
        faults.add("camera.left intermittent frame=9")
        faults.add("camera.right intermittent count=2")
        faults.add("board off")
    struck = [faults.strike("camera.left", "intermittent", frame=k) is not None for k in (8, None, 9, 9)]
    assert struck == [False, False, True, False], "the next sequence is whole again"
    struck = [faults.strike("camera.right", "intermittent", frame=k) is not None for k in range(4)]
    assert struck == [True, True, False, False]
    with hand_time.condition:
        faults.clear()
    assert faults.active("board", "off") is None
