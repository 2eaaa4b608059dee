"""The instrument's decisions: a pure state machine, its events, effects and alerts."""
