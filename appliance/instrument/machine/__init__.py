"""The decision about what the instrument does next: a pure state machine, its events, its effects and its alerts."""
