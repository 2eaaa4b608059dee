"""Debouncing: contact states with times in, key events out. Pure: it never reads a clock.

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
    """True for a key held since before the first report, or stuck: silent until seen released."""
    stuck_told: bool = False
    faulty: bool = False


class Debouncer:
    """Turns contact states into presses, long presses, releases and stuck keys.

    A change counts when it has held for 30 ms and is dated to its beginning. Call ``contacts`` for every report and
    ``advance`` when time passes without one; times must not run backwards. Keys are independent: a stuck one does not
    disturb the others. Keys that are down in the first report are masked until released.
    """

    def __init__(self) -> None:
        self._keys = {key: _KeyState() for key in Key}
        self._listening = False

    def contacts(self, now_ns: int, pressed: frozenset[Key], faulty: frozenset[Key]) -> list[KeyEvent]:
        """Take a report with the closed and the faulty coils, and return the events."""
        events = self.advance(now_ns)
        for key, state in self._keys.items():
            contact = key in pressed
            # A key that is down in the first report was not pressed for this program.
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
                    freed_events: list[tuple[int, KeyEvent]] = []
                    self._free(key, state, freed_events)
                    events += [event for _, event in freed_events]
        self._listening = True
        return events

    def advance(self, now_ns: int) -> list[KeyEvent]:
        """Return the events that became due by ``now_ns``, in the order of their times."""
        events: list[tuple[int, KeyEvent]] = []
        for key, state in self._keys.items():
            # Twice: a long press may become due before the contact settled to open, and another one may begin after it
            # settled to closed.
            self._hold(key, state, now_ns, events)
            self._settle(key, state, now_ns, events)
            self._hold(key, state, now_ns, events)
        events.sort(key=lambda item: item[0])
        return [event for _, event in events]

    def due_ns(self) -> int | None:
        """Return the time of the next event without a report; ``None`` if there is none."""
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
        """Make a contact that has held long enough the debounced state."""
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
        """Report a key that is held as a long press, later as stuck."""
        if not state.down:
            return
        # An open contact may be bounce or the release: until that is known, the key counts as held until the opening.
        held_ns = (now_ns if state.contact else state.contact_since_ns) - state.down_since_ns
        if held_ns >= LONG_PRESS_NS and not state.long_told and not state.masked:
            state.long_told = True
            at_ns = state.down_since_ns + LONG_PRESS_NS
            events.append((at_ns, KeyLongPress(key, at_ns)))
        if held_ns >= STUCK_NS and not state.stuck_told:
            events.append((state.down_since_ns + STUCK_NS, self._stick(key, state)))

    def _free(self, key: Key, state: _KeyState, events: list[tuple[int, KeyEvent]]) -> None:
        """Unmask a key that works again; report this only if it was reported stuck."""
        if state.stuck_told:
            events.append((state.contact_since_ns, KeyFreed(key)))
        state.masked = state.stuck_told = False

    def _stick(self, key: Key, state: _KeyState) -> KeyStuck:
        state.masked = state.stuck_told = True
        return KeyStuck(key)
