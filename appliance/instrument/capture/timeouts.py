"""Owns how long capture waits for what the projector paces: in its periods, and never less than a host may be late."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Timeouts:
    """Time limits of a sequence. At 60 Hz and faster the seconds count, at slower rates the periods."""

    refresh_hz: float

    def _at_least(self, seconds: float, periods: float) -> float:
        return max(seconds, periods / self.refresh_hz)

    @property
    def ready_s(self) -> float:
        """Time for both cameras to leave their live views, and again for both to start: their images come as slowly."""
        return self._at_least(2.0, 12)

    @property
    def first_frame_s(self) -> float:
        """Time from a camera that is ready to its first frame: the other one, the heartbeat, the blank to begin
        with."""
        return self._at_least(2.0, 24)

    @property
    def next_frame_s(self) -> float:
        """A frame that has not come by then was lost."""
        return self._at_least(0.15, 9)

    @property
    def silence_s(self) -> float:
        """Two vertical blanks, and a little, in which no frame may follow the last."""
        return self._at_least(0.035, 2.1)

    @property
    def collect_s(self) -> float:
        """Time from the last pattern until a camera has its last frame, or has given it up."""
        return self._at_least(2.5, 12)

    @property
    def pulse_s(self) -> float:
        """Time from one pulse's report to the next."""
        return self._at_least(0.25, 3)

    @property
    def margin_s(self) -> float:
        """Time beyond the length of the sequence: to find the vertical blank, to wait for frames that do not come."""
        return self._at_least(5.0, 40)
