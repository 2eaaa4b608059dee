"""World time never goes back, never passes what is still to happen, and every wait in it ends."""

from __future__ import annotations

import time
from collections.abc import Callable

from hw_sim.timing.world_time import START_NS, WorldTime
from tests.hw_sim.conftest import Bench, HandTime


def test_what_happens_sees_its_own_moment_however_late_it_is_done() -> None:
    world_time = WorldTime()
    # Late enough that a busy computer gets here before it, and before the blank, where time halts anyway.
    moment_ns = START_NS + 12_000_000
    seen: list[int] = []
    with world_time.condition:
        world_time.at(moment_ns, lambda t: seen.append(world_time.now_ns() - t))
        time.sleep(0.03)
        assert world_time.now_ns() == moment_ns, "time passed something that has not happened"
        world_time.happen()
        assert seen == [0]
        assert world_time.now_ns() > moment_ns + 2_000_000, "time must catch up with real time"


def test_things_happen_in_the_order_of_their_moments(hand_time: HandTime) -> None:
    order: list[str] = []
    with hand_time.condition:
        hand_time.at(START_NS + 300, lambda _: order.append("late"))
        hand_time.at(START_NS + 100, lambda t: hand_time.at(t + 50, lambda _: order.append("planned by early")))
        hand_time.at(START_NS + 100, lambda _: order.append("early"))
    hand_time.run(1e-6)
    assert order == ["early", "planned by early", "late"]
    assert hand_time.now_ns() == START_NS + 1000


def test_a_wait_counts_world_time_and_ends(make_bench: Callable[..., Bench]) -> None:
    fast = make_bench(idle_speed=5.0).world.time
    slept_s = []
    for _ in range(3):  # the fastest counts: a busy machine wakes its sleepers late
        real_s, world_ns = time.monotonic(), fast.now_ns()
        fast.sleep_s(0.5)
        slept_s.append(((fast.now_ns() - world_ns) / 1e9, time.monotonic() - real_s))
    assert all(world_s >= 0.5 for world_s, _ in slept_s)
    assert min(slept_s)[0] < 0.6
    assert min(real_s for _, real_s in slept_s) < 0.4
