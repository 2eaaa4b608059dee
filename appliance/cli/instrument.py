"""The verbs ``run`` and ``check``, and the start of the instrument's service, also in a simulated world."""

from __future__ import annotations

import faulthandler
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from appliance.base import importing
from appliance.cli.output import Exit, ProgressLine, table
from appliance.cli.places import WithRig, WithRoot

if TYPE_CHECKING:
    from appliance.store import Rig
    from drivers.api import Health

# The service is imported when it starts, because a wrong word needs neither drivers nor compiled kernels.


@dataclass(frozen=True, slots=True, kw_only=True)
class Run(WithRoot):
    """Run the instrument until it is switched off."""

    service: ClassVar[bool] = True

    def run(self) -> Exit:
        """Serve until the instrument is switched off; a given root is used, and made if it does not exist."""
        rig, root = self.read_rig(), self.new_root()
        if root is not None:
            rig = replace(rig, storage=replace(rig.storage, root=root))
        return serve(rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(WithRig):
    """Open every device once and report its state; FAILED if any does not work."""

    def run(self) -> Exit:
        rig = self.read_rig()
        from appliance.instrument import check

        with ProgressLine() as progress:
            progress("asking the devices")
            states = check(rig)
        facts = ("serial", "link", "firmware")
        rows = [
            (h.device, "ok" if h.ok else "FAILED", *(h.details.get(fact, "-") for fact in facts), h.summary)
            for h in states
        ]
        self.tell(
            [{"device": h.device, "ok": h.ok, "summary": h.summary, "details": dict(h.details)} for h in states],
            [
                table(("DEVICE", "", *(fact.upper() for fact in facts), "IDENTITY, OR FAULT"), rows),
                "",
                table(("BUS", "FOUND"), _buses(states)),
            ],
        )
        return Exit.OK if all(h.ok for h in states) else Exit.FAILED


def _buses(states: Sequence[Health]) -> list[tuple[str, str]]:
    """Return the devices on each bus, one line each, with the bus in the first."""
    rows: list[tuple[str, str]] = []
    for name, device in (
        ("cameras", "camera.left"),
        ("serial ports", "board"),
        ("HID", "keys"),
        ("video", "projector"),
    ):
        details = next((state.details for state in states if state.device == device), {})
        lines = details.get("there", "nothing").split("; ")
        rows += [(name if k == 0 else "", line) for k, line in enumerate(lines)]
    return rows


def serve(rig: Rig) -> Exit:
    """Run the instrument's service on ``rig`` until it ends. Kernels must have been found before."""
    faulthandler.enable(all_threads=True)  # shows where it was if it is killed or a library crashes
    with importing():
        from appliance.instrument import run

    return Exit(run(rig))
