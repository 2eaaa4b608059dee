"""What is given up when nobody reads."""

import pytest

from drivers.api import BoardEvent, LaserState, Pulse, Telemetry
from drivers.board.queue import EventQueue
from tests.drivers.clock import SteppedClock


def beat(time_us: int) -> Telemetry:
    return Telemetry(0, time_us, 0, LaserState(False, False))


def pulse(k: int) -> Pulse:
    return Pulse(k, k, k)


@pytest.mark.parametrize(
    ("capacity", "put", "left"),
    [
        (5, [pulse(k) for k in range(5)], [pulse(k) for k in range(5)]),
        (3, [beat(1), pulse(0), beat(2), pulse(1), pulse(2)], [pulse(0), pulse(1), pulse(2)]),
        (2, [pulse(k) for k in range(5)], [pulse(3), pulse(4)]),
        (2, [beat(1), beat(2), beat(3)], [beat(2), beat(3)]),
        (1, [pulse(0), pulse(1)], [pulse(1)]),
    ],
    ids=["in order", "heartbeats before pulses", "the oldest pulses", "the oldest heartbeat", "a queue of one"],
)
def test_what_is_given_up_is_counted(capacity: int, put: list[BoardEvent], left: list[BoardEvent]) -> None:
    queue = EventQueue(SteppedClock(), capacity)
    for event in put:
        queue.put(event)
    assert [queue.get(0.0) for _ in range(len(left) + 1)] == [*left, None]
    assert queue.dropped == len(put) - len(left)


def test_a_queue_without_room_is_refused_and_an_empty_one_waits_its_timeout() -> None:
    for capacity in (0, -1):
        with pytest.raises(ValueError, match=f"capacity {capacity}"):
            EventQueue(SteppedClock(), capacity)
    clock = SteppedClock()
    assert EventQueue(clock).get(0.25) is None
    assert clock.now_ns() - SteppedClock().now_ns() == 250_000_000
