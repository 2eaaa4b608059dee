"""The verbs ``run`` and ``check``, and how the instrument's service is started, also in a simulated world."""

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

# The service is imported when it starts: it brings drivers and compiled kernels, which a wrong word can do without.


@dataclass(frozen=True, slots=True, kw_only=True)
class Run(WithRoot):
    """The instrument, until it is switched off."""

    service: ClassVar[bool] = True

    def run(self) -> Exit:
        """Serve until the instrument is switched off; a root that was given is used, and made if it is not there."""
        rig, root = self.read_rig(), self.new_root()
        if root is not None:
            rig = replace(rig, storage=replace(rig.storage, root=root))
        return serve(rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(WithRig):
    """Open every device once and say what it says about itself; FAILED if any does not work."""

    def run(self) -> Exit:
        rig = self.read_rig()
        from appliance.instrument import check

        with ProgressLine() as progress:
            progress("asking the devices")
            found = check(rig)
        facts = ("serial", "link", "firmware")
        rows = [
            (h.device, "ok" if h.ok else "FAILED", *(h.details.get(fact, "-") for fact in facts), h.summary)
            for h in found
        ]
        self.tell(
            [{"device": h.device, "ok": h.ok, "summary": h.summary, "details": dict(h.details)} for h in found],
            [
                table(("DEVICE", "", *(fact.upper() for fact in facts), "WHAT IT IS, OR WHAT IS WRONG"), rows),
                "",
                table(("BUS", "WHAT IS THERE"), _buses(found)),
            ],
        )
        return Exit.OK if all(h.ok for h in found) else Exit.FAILED


def _buses(found: Sequence[Health]) -> list[tuple[str, str]]:
    """Return what is on each bus, one line each, the bus named in its first."""
    rows: list[tuple[str, str]] = []
    for name, device in (
        ("cameras", "camera.left"),
        ("serial ports", "board"),
        ("HID", "keys"),
        ("video", "projector"),
    ):
        details = next((one.details for one in found if one.device == device), {})
        lines = details.get("there", "nothing").split("; ")
        rows += [(name if k == 0 else "", line) for k, line in enumerate(lines)]
    return rows


def serve(rig: Rig) -> Exit:
    """Run the instrument's service on ``rig`` until it ends. Its kernels must have been found before."""
    faulthandler.enable(all_threads=True)  # who kills it because it hangs, or it dies in a library: where was it?
    with importing():
        from appliance.instrument import run

    return Exit(run(rig))
