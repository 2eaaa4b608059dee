"""What counts as a press: times in ms in, events out."""

from __future__ import annotations

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


def test_a_press_counts_when_it_has_held_for_30_ms_and_is_dated_to_its_beginning() -> None:
    pad = Pad()
    pad.at(100, Key.SCAN)
    pad.until(129.9)
    assert pad.said == []
    pad.until(130)
    assert pad.said == [KeyPress(Key.SCAN, 100 * MS)]


def test_bounce_of_20_ms_is_one_press() -> None:
    pad = Pad()
    for time_ms, pressed in ((100, True), (104, False), (109, True), (113, False), (120, True)):
        pad.at(time_ms, *([Key.SCAN] if pressed else []))
    pad.until(300)
    assert pad.said == [KeyPress(Key.SCAN, 120 * MS)]


def test_a_ghost_of_25_ms_is_nothing() -> None:
    pad = Pad()
    pad.at(100, Key.UP)
    pad.at(125)
    pad.until(2000)
    assert pad.said == []


def test_a_short_press_is_press_and_release() -> None:
    pad = Pad()
    pad.at(100, Key.SCAN)
    pad.at(250)
    pad.until(400)
    assert pad.said == [KeyPress(Key.SCAN, 100 * MS), KeyRelease(Key.SCAN, 250 * MS, 0.15)]


def test_a_long_press_is_told_while_held_and_once() -> None:
    pad = Pad()
    pad.at(0, Key.BACK)
    pad.until(799)
    assert pad.said == [KeyPress(Key.BACK, 0)]
    pad.until(801)
    pad.until(2000)
    pad.at(2000)
    pad.until(2100)
    assert pad.said == [KeyPress(Key.BACK, 0), KeyLongPress(Key.BACK, 800 * MS), KeyRelease(Key.BACK, 2000 * MS, 2.0)]


def test_a_press_of_790_ms_that_is_noticed_late_is_not_long() -> None:
    pad = Pad()
    pad.at(0, Key.BACK)
    pad.until(50)
    pad.at(790)
    pad.until(5000)
    assert [type(event) for event in pad.said] == [KeyPress, KeyRelease]


def test_a_release_just_before_800_ms_is_no_long_press_although_it_is_known_only_after() -> None:
    pad = Pad()
    pad.at(0, Key.BACK)
    pad.at(780)
    pad.until(805)
    pad.until(900)
    assert [type(event) for event in pad.said] == [KeyPress, KeyRelease]


def test_bounce_at_800_ms_does_not_prevent_a_long_press() -> None:
    pad = Pad()
    pad.at(0, Key.BACK)
    pad.at(790)
    pad.at(805, Key.BACK)
    pad.until(806)
    assert pad.said == [KeyPress(Key.BACK, 0), KeyLongPress(Key.BACK, 800 * MS)]


def test_a_key_held_longer_than_8_s_is_stuck_and_silent_until_released() -> None:
    pad = Pad()
    pad.at(0, Key.SCAN)
    pad.until(8100)
    assert pad.said[-1] == KeyStuck(Key.SCAN)
    count = len(pad.said)
    pad.until(60_000)
    assert len(pad.said) == count
    pad.at(60_000)
    pad.until(60_100)
    assert pad.said[count:] == [KeyFreed(Key.SCAN)]
    pad.at(61_000, Key.SCAN)
    pad.until(61_050)
    assert pad.said[count:] == [KeyFreed(Key.SCAN), KeyPress(Key.SCAN, 61_000 * MS)]


def test_a_stuck_key_leaves_the_others_alone() -> None:
    pad = Pad()
    pad.at(0, Key.SCAN)
    pad.until(9000)
    pad.at(9000, Key.SCAN, Key.UP)
    pad.at(9100, Key.SCAN)
    pad.until(9200)
    assert pad.said[-2:] == [KeyPress(Key.UP, 9000 * MS), KeyRelease(Key.UP, 9100 * MS, 0.1)]


def test_a_coil_that_reports_a_fault_is_stuck_until_it_recovers() -> None:
    pad = Pad()
    pad.at(0, faulty=frozenset({Key.DOWN}))
    pad.at(100, Key.DOWN, faulty=frozenset({Key.DOWN}))
    pad.at(200, faulty=frozenset({Key.DOWN}))
    pad.until(300)
    assert pad.said == [KeyStuck(Key.DOWN)]
    pad.at(400)
    pad.at(500, Key.DOWN)
    pad.until(600)
    assert pad.said[1:] == [KeyFreed(Key.DOWN), KeyPress(Key.DOWN, 500 * MS)]


def test_a_faulty_coil_that_recovers_while_the_key_is_held_is_free_only_when_it_is_released() -> None:
    pad = Pad()
    pad.at(100, Key.UP, faulty=frozenset({Key.UP}))
    assert pad.said == [KeyStuck(Key.UP)]
    pad.at(200, Key.UP)
    pad.until(2000)
    assert pad.said == [KeyStuck(Key.UP)], "still down"
    pad.at(2100)
    pad.until(2200)
    assert pad.said == [KeyStuck(Key.UP), KeyFreed(Key.UP)]
    pad.at(2300, Key.UP)
    pad.until(2400)
    assert pad.said[2:] == [KeyPress(Key.UP, 2300 * MS)]


def test_a_stuck_key_whose_coil_then_reports_a_fault_is_not_free_although_it_opened() -> None:
    pad = Pad()
    pad.at(100, Key.UP)
    pad.until(8200)
    assert pad.said[-1] == KeyStuck(Key.UP)
    told = len(pad.said)
    pad.at(8300, faulty=frozenset({Key.UP}))
    pad.until(9000)
    assert pad.said[told:] == []
    pad.at(9100)
    pad.until(9200)
    assert pad.said[told:] == [KeyFreed(Key.UP)]


def test_a_fault_that_ends_as_the_key_opens_frees_it_without_a_release() -> None:
    pad = Pad()
    pad.at(100, Key.UP, faulty=frozenset({Key.UP}))
    pad.until(200)
    pad.at(300)
    pad.until(310)
    assert pad.said == [KeyStuck(Key.UP)], "it may be bounce"
    pad.until(400)
    assert pad.said == [KeyStuck(Key.UP), KeyFreed(Key.UP)]


def test_every_long_press_is_told_not_only_the_first() -> None:
    pad = Pad()
    for begin in (100, 2000, 4000):
        pad.at(begin, Key.BACK)
        pad.until(begin + 900)
        pad.at(begin + 1000)
        pad.until(begin + 1100)
    long = [event for event in pad.said if isinstance(event, KeyLongPress)]
    assert long == [KeyLongPress(Key.BACK, (begin + 800) * MS) for begin in (100, 2000, 4000)]


def test_a_key_that_was_down_before_we_listened_presses_nothing() -> None:
    pad = Pad(Key.SCAN)
    pad.until(2000)
    pad.at(2000)
    pad.until(2100)
    assert pad.said == []
    pad.at(3000, Key.SCAN)
    pad.until(3100)
    assert pad.said == [KeyPress(Key.SCAN, 3000 * MS)]


def test_a_key_that_was_down_before_we_listened_may_be_found_stuck() -> None:
    pad = Pad(Key.SCAN)
    pad.until(8000)
    assert pad.said == [KeyStuck(Key.SCAN)]


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


steps = st.lists(st.tuples(st.integers(1, 3000), st.integers(0, 15), st.booleans()), max_size=40)


@given(steps)
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


@given(steps)
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
        assert [e for e in lazy.said if e.key is key] == [  # type: ignore[union-attr]
            e
            for e in eager.said
            if e.key is key  # type: ignore[union-attr]
        ]
