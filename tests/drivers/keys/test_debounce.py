"""What counts as a press: times in ms in, events out."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import Key, KeyEvent, KeyFreed, KeyLongPress, KeyPress, KeyRelease, KeyStuck
from drivers.keys.debounce import Debouncer

MS = 1_000_000
NOTHING: frozenset[Key] = frozenset()


class Pad:
    """A debouncer that is told contacts at ms, and what it said."""

    def __init__(self, *down_at_start: Key) -> None:
        self.debouncer = Debouncer()
        self.said: list[KeyEvent] = self.debouncer.contacts(0, frozenset(down_at_start), NOTHING)

    def at(self, time_ms: float, *pressed: Key, faulty: frozenset[Key] = NOTHING) -> None:
        self.said += self.debouncer.contacts(round(time_ms * MS), frozenset(pressed), faulty)

    def until(self, time_ms: float) -> None:
        self.said += self.debouncer.advance(round(time_ms * MS))


Step = Callable[[Pad], None]
SCAN, BACK, UP, DOWN = Key.SCAN, Key.BACK, Key.UP, Key.DOWN


def at(time_ms: float, *pressed: Key, faulty: Key | None = None) -> Step:
    return lambda pad: pad.at(time_ms, *pressed, faulty=NOTHING if faulty is None else frozenset({faulty}))


def until(time_ms: float) -> Step:
    return lambda pad: pad.until(time_ms)


HELD_8_S: list[KeyEvent] = [KeyPress(SCAN, 0), KeyLongPress(SCAN, 800 * MS), KeyStuck(SCAN)]
CASES: dict[str, tuple[list[Step], list[KeyEvent]]] = {
    "nothing before 30 ms": ([at(100, SCAN), until(129.9)], []),
    "bounce of 20 ms is one press, dated to its end": (
        [at(100, SCAN), at(104), at(109, SCAN), at(113), at(120, SCAN), until(150)],
        [KeyPress(SCAN, 120 * MS)],
    ),
    "a ghost of 25 ms is nothing": ([at(100, UP), at(125), until(2000)], []),
    "a short press": (
        [at(100, SCAN), at(250), until(400)],
        [KeyPress(SCAN, 100 * MS), KeyRelease(SCAN, 250 * MS, 0.15)],
    ),
    "each long press, while it is held, and each once": (
        [at(0, BACK), until(801), until(2000), at(2000), until(2100), at(4000, BACK), until(4799)],
        [
            *(KeyPress(BACK, 0), KeyLongPress(BACK, 800 * MS), KeyRelease(BACK, 2000 * MS, 2.0)),
            KeyPress(BACK, 4000 * MS),
        ],
    ),
    "790 ms, noticed late, are not long": (
        [at(0, BACK), until(50), at(790), until(5000)],
        [KeyPress(BACK, 0), KeyRelease(BACK, 790 * MS, 0.79)],
    ),
    "bounce at 800 ms does not prevent a long press": (
        [at(0, BACK), at(790), at(805, BACK), until(806)],
        [KeyPress(BACK, 0), KeyLongPress(BACK, 800 * MS)],
    ),
    "stuck after 8 s until it is released, and the others are not": (
        [at(0, SCAN), until(8100), at(9000, SCAN, UP), at(9100, SCAN), at(60_000), at(61_000, SCAN), until(61_050)],
        [
            *(*HELD_8_S, KeyPress(UP, 9000 * MS), KeyRelease(UP, 9100 * MS, 0.1)),
            *(KeyFreed(SCAN), KeyPress(SCAN, 61_000 * MS)),
        ],
    ),
    "a faulty coil is stuck until it recovers": (
        [at(0, faulty=DOWN), at(100, DOWN, faulty=DOWN), until(300), at(400), at(500, DOWN), until(600)],
        [KeyStuck(DOWN), KeyFreed(DOWN), KeyPress(DOWN, 500 * MS)],
    ),
    "a coil that recovers while its key is held or as it closes is not free yet": (
        [at(100, UP, faulty=UP), at(200, UP), at(300, UP, faulty=DOWN), at(400, UP, DOWN), until(2000)],
        [KeyStuck(UP), KeyStuck(DOWN)],
    ),
    "it is when that is released": (
        [at(100, UP, faulty=UP), at(200, UP), until(2000), at(2100), until(2200), at(2300, UP), until(2400)],
        [KeyStuck(UP), KeyFreed(UP), KeyPress(UP, 2300 * MS)],
    ),
    "a stuck key that opens while its coil is faulty is not free yet": (
        [at(0, SCAN), until(8100), at(8300, faulty=SCAN), until(9000)],
        HELD_8_S,
    ),
    "it is when that recovers": (
        [at(0, SCAN), until(8100), at(8300, faulty=SCAN), until(9000), at(9100), until(9200)],
        [*HELD_8_S, KeyFreed(SCAN)],
    ),
    "a fault that ends as the key opens may be bounce": (
        [at(100, UP, faulty=UP), until(200), at(300), until(310)],
        [KeyStuck(UP)],
    ),
    "it frees without a release": (
        [at(100, UP, faulty=UP), until(200), at(300), until(400)],
        [KeyStuck(UP), KeyFreed(UP)],
    ),
}


@pytest.mark.parametrize(("steps", "said"), CASES.values(), ids=CASES.keys())
def test_contacts_become_events(steps: list[Step], said: list[KeyEvent]) -> None:
    pad = Pad()
    for step in steps:
        step(pad)
    assert pad.said == said


def test_a_key_that_was_down_before_we_listened_presses_nothing_but_may_be_found_stuck() -> None:
    pad = Pad(SCAN)
    for step in (until(2000), at(2000), until(2100), at(3000, SCAN), until(3100)):
        step(pad)
    assert pad.said == [KeyPress(SCAN, 3000 * MS)]
    stuck = Pad(SCAN)
    stuck.until(8000)
    assert stuck.said == [KeyStuck(SCAN)]


def test_due_is_when_the_next_event_becomes_true() -> None:
    pad = Pad()
    assert pad.debouncer.due_ns() is None
    pad.at(100, Key.SCAN)
    for due_ms in (130, 900, 8100):
        assert pad.debouncer.due_ns() == due_ms * MS
        before = len(pad.said)
        pad.until(due_ms)
        assert len(pad.said) == before + 1
    assert pad.debouncer.due_ns() is None


scripts = st.lists(st.tuples(st.integers(1, 3000), st.integers(0, 15), st.booleans()), max_size=40)


@given(scripts)
def test_presses_and_releases_alternate_whatever_the_coils_do(script: list[tuple[int, int, bool]]) -> None:
    pad = Pad()
    now_ms = 0
    for step_ms, mask, report in script:
        now_ms += step_ms
        if report:
            pad.at(now_ms, *(key for i, key in enumerate(Key) if mask >> i & 1))
        else:
            pad.until(now_ms)
    pad.until(now_ms + 20_000)
    for key in Key:
        down = False
        last_ns = -1
        for event in (e for e in pad.said if e.key is key):  # type: ignore[union-attr]
            match event:
                case KeyPress(time_ns=time_ns):
                    assert not down
                    assert time_ns > last_ns
                    down, last_ns = True, time_ns
                case KeyRelease(time_ns=time_ns, held_s=held_s):
                    assert down
                    assert time_ns >= last_ns + 30 * MS
                    assert held_s * 1e9 == time_ns - last_ns or abs(held_s * 1e9 - (time_ns - last_ns)) < 1
                    down, last_ns = False, time_ns
                case KeyLongPress(time_ns=time_ns):
                    assert down
                    assert time_ns == last_ns + 800 * MS
                case KeyStuck():
                    down = False


@given(scripts)
def test_it_does_not_matter_how_often_time_is_looked_at(script: list[tuple[int, int, bool]]) -> None:
    lazy, eager = Pad(), Pad()
    now_ms = 0
    for step_ms, mask, _ in script:
        for k in range(4):
            eager.until(now_ms + step_ms * k / 4)
        now_ms += step_ms
        pressed = [key for i, key in enumerate(Key) if mask >> i & 1]
        lazy.at(now_ms, *pressed)
        eager.at(now_ms, *pressed)
    lazy.until(now_ms + 20_000)
    eager.until(now_ms + 20_000)
    for key in Key:
        of_lazy, of_eager = ([e for e in pad.said if e.key is key] for pad in (lazy, eager))  # type: ignore[union-attr]
        assert of_lazy == of_eager
