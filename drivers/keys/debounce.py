"""Owns what a press is: contact states with times in, debounced key events out. Pure: it never looks at a clock.

Source: ``docs/protocols/keys.md``; inductive coils bounce for up to 20 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.api import Key, KeyEvent, KeyFreed, KeyLongPress, KeyPress, KeyRelease, KeyStuck

DEBOUNCE_NS = 30_000_000
LONG_PRESS_NS = 800_000_000
STUCK_NS = 8_000_000_000


@dataclass(slots=True)
class _KeyState:
    contact: bool = False
    """State of the contact, as the coil says."""
    contact_since_ns: int = 0
    down: bool = False
    """The debounced state."""
    down_since_ns: int = 0
    long_told: bool = False
    masked: bool = False
    """True for a key held since before we listened, or stuck: silent until seen released."""
    stuck_told: bool = False
    faulty: bool = False


class Debouncer:
    """Turns contact states into presses, long presses, releases and stuck keys.

    A change counts when it has held for 30 ms and is dated to its beginning. Feed it with ``contacts`` for every
    report and with ``advance`` when time passes without one; times must not run backwards. Each key is on its own:
    a stuck one does not disturb the others. Keys that are down in the first report are masked until released.
    """

    def __init__(self) -> None:
        self._keys = {key: _KeyState() for key in Key}
        self._listening = False

    def contacts(self, now_ns: int, pressed: frozenset[Key], faulty: frozenset[Key]) -> list[KeyEvent]:
        """A report arrived: these coils are closed, these are faulty."""
        events = self.advance(now_ns)
        for key, state in self._keys.items():
            contact = key in pressed
            # A key that is down when we begin to listen was pressed for somebody else.
            if not self._listening:
                state.contact = state.down = state.masked = contact
                state.contact_since_ns = state.down_since_ns = now_ns
            elif contact != state.contact:
                state.contact = contact
                state.contact_since_ns = now_ns
            if (key in faulty) != state.faulty:
                state.faulty = key in faulty
                if state.faulty and not state.stuck_told:
                    events.append(self._stick(key, state))
                elif not state.faulty and not state.down and not contact:
                    told: list[tuple[int, KeyEvent]] = []
                    self._free(key, state, told)
                    events += [event for _, event in told]
        self._listening = True
        return events

    def advance(self, now_ns: int) -> list[KeyEvent]:
        """Time passed: what became true since the last call, in the order in which it became true."""
        events: list[tuple[int, KeyEvent]] = []
        for key, state in self._keys.items():
            # Twice: a long press may have become true before the contact settled to open, and another one begin after
            # it settled to closed.
            self._hold(key, state, now_ns, events)
            self._settle(key, state, now_ns, events)
            self._hold(key, state, now_ns, events)
        events.sort(key=lambda item: item[0])
        return [event for _, event in events]

    def due_ns(self) -> int | None:
        """Time at which ``advance`` has something to say although no report comes; ``None`` when never."""
        times: list[int] = []
        for state in self._keys.values():
            if state.contact != state.down:
                times.append(state.contact_since_ns + DEBOUNCE_NS)
            elif state.down and not state.stuck_told:
                if not state.long_told and not state.masked:
                    times.append(state.down_since_ns + LONG_PRESS_NS)
                times.append(state.down_since_ns + STUCK_NS)
        return min(times, default=None)

    def _settle(self, key: Key, state: _KeyState, now_ns: int, events: list[tuple[int, KeyEvent]]) -> None:
        """A contact that has held long enough becomes the state."""
        if state.contact == state.down or now_ns - state.contact_since_ns < DEBOUNCE_NS:
            return
        # Dated to the beginning of the change, not to the end of the wait: the time a key was held does not contain the
        # debouncing.
        state.down = state.contact
        since_ns = state.contact_since_ns
        if state.down:
            state.down_since_ns = since_ns
            state.long_told = False
            if not state.masked:
                events.append((since_ns, KeyPress(key, since_ns)))
        elif not state.masked:
            events.append((since_ns, KeyRelease(key, since_ns, (since_ns - state.down_since_ns) / 1e9)))
        elif not state.faulty:
            self._free(key, state, events)

    def _hold(self, key: Key, state: _KeyState, now_ns: int, events: list[tuple[int, KeyEvent]]) -> None:
        """A key that is held becomes a long press, later a stuck key."""
        if not state.down:
            return
        # An open contact may be bounce or the release: until that is known, the key was held up to its opening.
        held_ns = (now_ns if state.contact else state.contact_since_ns) - state.down_since_ns
        if held_ns >= LONG_PRESS_NS and not state.long_told and not state.masked:
            state.long_told = True
            at_ns = state.down_since_ns + LONG_PRESS_NS
            events.append((at_ns, KeyLongPress(key, at_ns)))
        if held_ns >= STUCK_NS and not state.stuck_told:
            events.append((state.down_since_ns + STUCK_NS, self._stick(key, state)))

    def _free(self, key: Key, state: _KeyState, events: list[tuple[int, KeyEvent]]) -> None:
        """Free a key that works again; who was told that it is stuck hears of it."""
        if state.stuck_told:
            events.append((state.contact_since_ns, KeyFreed(key)))
        state.masked = state.stuck_told = False

    def _stick(self, key: Key, state: _KeyState) -> KeyStuck:
        state.masked = state.stuck_told = True
        return KeyStuck(key)
