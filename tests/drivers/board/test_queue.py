"""What is given up when nobody reads."""

import pytest

from drivers.api import BoardEvent, LaserState, Pulse, Telemetry
from drivers.board.queue import EventQueue
from tests.drivers.clock import SteppedClock


def heartbeat(time_us: int) -> Telemetry:
    return Telemetry(0, time_us, 0, LaserState(False, False))


def drain(queue: EventQueue) -> list[BoardEvent]:
    events: list[BoardEvent] = []
    while (event := queue.get(0.0)) is not None:
        events.append(event)
    return events


def test_events_come_in_order() -> None:
    queue = EventQueue(SteppedClock())
    for k in range(5):
        queue.put(Pulse(k, k, k))
    assert drain(queue) == [Pulse(k, k, k) for k in range(5)]


def test_heartbeats_are_given_up_before_pulses() -> None:
    queue = EventQueue(SteppedClock(), capacity=3)
    for event in (heartbeat(1), Pulse(0, 0, 0), heartbeat(2), Pulse(1, 1, 1), Pulse(2, 2, 2)):
        queue.put(event)
    assert drain(queue) == [Pulse(0, 0, 0), Pulse(1, 1, 1), Pulse(2, 2, 2)]
    assert queue.dropped == 2


def test_a_loss_of_pulses_is_counted() -> None:
    queue = EventQueue(SteppedClock(), capacity=2)
    for k in range(5):
        queue.put(Pulse(k, k, k))
    assert drain(queue) == [Pulse(3, 3, 3), Pulse(4, 4, 4)]
    assert queue.dropped == 3


@pytest.mark.parametrize("capacity", [0, -1])
def test_a_queue_without_room_is_refused(capacity: int) -> None:
    with pytest.raises(ValueError, match=f"capacity {capacity}; at least 1"):
        EventQueue(SteppedClock(), capacity)


def test_the_oldest_heartbeat_is_given_up_not_the_newest_and_a_queue_of_one_keeps_the_last_word() -> None:
    queue = EventQueue(SteppedClock(), capacity=2)
    for event in (heartbeat(1), heartbeat(2), heartbeat(3)):
        queue.put(event)
    assert drain(queue) == [heartbeat(2), heartbeat(3)]
    single = EventQueue(SteppedClock(), capacity=1)
    for k in range(2):
        single.put(Pulse(k, k, k))
    assert drain(single) == [Pulse(1, 1, 1)]
    assert (queue.dropped, single.dropped) == (1, 1)


def test_an_empty_queue_waits_its_timeout() -> None:
    clock = SteppedClock()
    begin_ns = clock.now_ns()
    assert EventQueue(clock).get(0.25) is None
    assert clock.now_ns() - begin_ns == 250_000_000
