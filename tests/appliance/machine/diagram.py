"""The page docs/states.md, made by walking the machine: ``./dev run python -m tests.appliance.machine.diagram``."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from appliance.machine import events as on
from appliance.machine.states import State
from appliance.machine.step import step
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import EVERY_EVENT, STARTS

PAGE = Path(__file__).parents[3] / "docs" / "states.md"
FROM_ALMOST_EVERYWHERE = 12
"""What as many states do alike is drawn once."""
Edge = tuple[State, State]


def edges() -> dict[Edge, set[str]]:
    """Every step from one state to another that any event takes, with what it is called."""
    found: dict[Edge, set[str]] = defaultdict(set)
    for way in STARTS:
        before = way()
        meant = labels(before)
        for event in EVERY_EVENT:
            after, _ = step(before, event)
            if after.state is before.state:
                continue
            match event:
                case on.KeyPressed(key):
                    called = f"key {meant.get(key, key.value)}"
                case on.KeyHeld(key):
                    called = f"key {meant.get(key, key.value)}"
                case on.ConditionRaised(fault):
                    called = fault.code.value
                case on.Tick():
                    called = "time"
                case _:
                    called = type(event).__name__
            found[before.state, after.state].add(called)
    return found


def page(found: dict[Edge, set[str]]) -> str:
    """The whole of docs/states.md."""
    sources: dict[tuple[str, State], set[State]] = defaultdict(set)
    for (source, target), names in found.items():
        for name in names:
            sources[name, target].add(source)
    common = {key for key, states in sources.items() if len(states) >= FROM_ALMOST_EVERYWHERE}
    lines = [
        "# States",
        "",
        "How one state of the instrument leads to another. Made by walking the machine (`appliance/machine`) from every state with",
        "every event: `./dev run python -m tests.appliance.machine.diagram` writes this page, and a test says when it has drifted.",
        "What each state is for stands beside its name in `appliance/machine/states.py`.",
        "",
        "`key` is a press by its label on the screen; `time` is a deadline, or results that were shown long enough; names in capitals are",
        "faults (`appliance/scan/fault.py`), others are events (`appliance/machine/events.py`).",
        "",
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {State.BOOT.value}",
        '    state "from every state" as ANY',
    ]
    for target in State:
        everywhere = sorted(name for name, state in common if state is target)
        if everywhere:
            lines.append(f"    ANY --> {target.value} : {', '.join(everywhere)}")
    for source in State:
        for target in State:
            own = sorted(name for name in found.get((source, target), ()) if (name, target) not in common)
            if own:
                lines.append(f"    {source.value} --> {target.value} : {_short(own)}")
    lines += [
        f"    {State.SHUTDOWN.value} --> [*]",
        "```",
        "",
        "## What ends what",
        "",
        "| from | to | by |",
        "|---|---|---|",
    ]
    for source in State:
        for target in State:
            if every := sorted(found.get((source, target), ())):
                lines.append(f"| {source.value} | {target.value} | {', '.join(every)} |")
    return "\n".join(lines) + "\n"


def _short(names: list[str]) -> str:
    """Not more than four in the picture; the table has them all."""
    return ", ".join(names[:4]) + (" …" if len(names) > 4 else "")


if __name__ == "__main__":
    PAGE.write_text(page(edges()), encoding="utf-8")
