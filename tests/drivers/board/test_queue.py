"""What is given up when nobody reads."""

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


def test_an_empty_queue_waits_its_timeout() -> None:
    clock = SteppedClock()
    begin_ns = clock.now_ns()
    assert EventQueue(clock).get(0.25) is None
    assert clock.now_ns() - begin_ns == 250_000_000
