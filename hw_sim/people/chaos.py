"""Owns the unluckiest of dives: devices are taken away and given back in random order while somebody goes on scanning.

Who scans knows the instrument through its status file, as a diver knows it through the screen: he scans, keeps or
repeats what he is shown, goes back to AIM whatever happens, and writes down what he was told. From the same seed he
breaks the same things and wants the same; what comes of it depends on how fast the computer is.
"""

from __future__ import annotations

import json
import random
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hw_sim.people import computer, status_file
from hw_sim.people.operator import PRESS_S, Operator, OperatorError

if TYPE_CHECKING:
    from hw_sim.world import World

TAKEN_AWAY = (
    "camera.left off", "camera.right off", "board off", "keypad off", "projector off", "sensor.TCASE off",
    "sensor.TPROJ off", "laser.left off",
)  # fmt: skip
SPOILT = (
    "camera.left intermittent frame={k}", "camera.right intermittent frame={k}", "camera.left wrong how=repeat frame={k}",
    "camera.right wrong how=swap frame={k}", "camera.left garbage how=truncate frame={k}",
    "camera.right garbage how=leader frame={k}", "camera.left garbage how=trailer frame={k}", "camera.right stuck frame={k}",
    "camera.left delayed amount=3.0", "camera.left off frame={k}", "camera.right off frame={k}", "projector delayed frame={k}",
    "projector wrong", "board wrong how=reset", "board intermittent frame={k}", "board garbage", "keypad garbage",
    "board off frame={k}",
)  # fmt: skip
COMPUTER = (("worker", "kill"), ("worker", "hang"), ("disk", "off"))
FRAMES = 20
"""Frames of the shortest sequence: a fault in one of them comes at any period."""
AIM_S, ANSWER_S, END_S, SAVE_S = 60.0, 3.0, 200.0, 60.0
"""Longest waits of world time: for AIM, for anything to happen on a key, for the end of a scan, for a save."""
LOST = "_LOST"
"""The code of a device that is away ends so."""
REJECT_HOLD_S = 1.2
REJECT_TRIES = 5
"""BACK held so long rejects a scan."""
READY_S = 45.0
"""Longest wait, after everything is repaired, until SCAN is answered with a scan."""
BREAK, GIVE_BACK, KEEP, BREAK_COMPUTER = 0.5, 0.75, 0.8, 0.06
"""Chances before each scan: that something breaks, that all is repaired; that a scan is kept; that it is the computer."""


@dataclass(slots=True)
class Report:
    """The record of one dive."""

    seed: int
    scans: int = 0
    """Number of presses of SCAN."""
    accepted: list[str] = field(default_factory=list)
    """Numbers of the scans that the screen called saved."""
    rejected: int = 0
    """Shown and not wanted."""
    refused: Counter[str] = field(default_factory=Counter)
    """Scans that were not recorded, or worthless, by the code that the screen gave as the reason."""
    unexplained: list[str] = field(default_factory=list)
    """Moments at which nothing happened and nothing said why."""
    alerts: Counter[str] = field(default_factory=Counter)
    """Number of times that each came up."""
    broken: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the record ready for JSON."""
        return {
            "seed": self.seed, "scans": self.scans, "accepted": self.accepted, "rejected": self.rejected,
            "refused": dict(self.refused), "unexplained": self.unexplained, "alerts": dict(self.alerts),
            "broken": self.broken,
        }  # fmt: skip


class ChaosDiver(Operator):
    """Presses SCAN ``scans`` times while things break; writes ``report`` (JSON) at the end, whatever it was."""

    def __init__(self, world: World, status: Path, seed: int, scans: int, report: Path) -> None:
        super().__init__(world, status)
        self._random = random.Random(seed)
        self._wanted = scans
        self._path = report
        self._disk_off = False
        self._before: set[str] = set()
        self.report = Report(seed)

    def act(self) -> None:
        """Scan again and again, then switch off. Raises OperatorError."""
        try:
            for _ in range(self._wanted):
                self._to_aim()
                self._break_something()
                self._scan_once()
                if self.over:
                    return
            self._repair()
            self._to_aim()
            if not self.switch_off() and not self.over:
                raise OperatorError(f"it cannot be switched off: {self.status().get('state')}")
            self.finished = True
        finally:
            self._path.write_text(json.dumps(self.report.as_dict()), encoding="utf-8")

    # ------------------------------------------------------------------------------------- what breaks

    def _break_something(self) -> None:
        # The order of the draws is the seed's dive: it does not depend on what the instrument answers.
        if self._random.random() < GIVE_BACK:
            self._repair()
        if self._random.random() < BREAK_COMPUTER:
            self._break_computer(self._random.choice(COMPUTER))
        elif self._random.random() < BREAK:
            sentence = self._random.choice(TAKEN_AWAY + SPOILT).format(k=self._random.randrange(FRAMES))
            if " frame=" not in sentence and self._random.random() < 0.5:
                sentence += f" at_s={self._random.uniform(0.0, 1.5):.2f}"
            self.world.fault(sentence)
            self.report.broken.append(sentence)
        self.sleep(self._random.uniform(0.0, 1.0))

    def _break_computer(self, what: tuple[str, ...]) -> None:
        try:
            computer.happen(what, self.status_path)
        except (ValueError, OSError):
            return  # there is no process now, or it is away already
        self._disk_off = self._disk_off or what == ("disk", "off")
        self.report.broken.append(" ".join(what))

    def _repair(self) -> None:
        self.world.clear_faults()
        if self._disk_off:
            computer.happen(("disk", "on"), self.status_path)
            self._disk_off = False

    # ------------------------------------------------------------------------------------- one scan

    def _to_aim(self) -> None:
        """Go home to AIM as a diver does: with BACK, and by waiting where nothing but time helps."""
        if self.until(self._aims, 1.0) or self.over:
            return
        for tries in range(int(AIM_S)):
            # A diver at a loss surfaces: what keeps the instrument from AIM by now is not going to mend itself.
            if tries == 20:
                self._repair()  # the key pad may be away, and the disk
            # From REVIEW it is held: elsewhere that might switch off.
            self.press("back", REJECT_HOLD_S if self._state() == "REVIEW" else PRESS_S)
            if self.until(self._aims, 1.0) or self.over:
                return
        raise OperatorError(f"BACK does not lead to AIM: {self._line()}")

    def _scan_once(self) -> None:
        """Press SCAN once, and write down what comes of it."""
        self.report.scans += 1
        told: list[str] = []
        """Reasons of a refusal, as soon as they are to be seen: they go when what they name comes back."""
        away = self._away()
        """The device that the screen calls lost: a reason for nothing to happen, even if it comes back right then."""

        def answered() -> bool:
            """Return whether SCAN was answered. An alert that comes or goes is no answer: its device may have just come back."""
            told.extend(filter(None, [self._reason(refused=True)]))
            return bool(told) or not self._aims()

        self.world.press("scan")
        if not self.until(answered, ANSWER_S) or told:
            self._not_recorded(told, away)
            return
        if not self.until(lambda: self._state() in ("REVIEW", "AIM", None), END_S):
            raise OperatorError(f"no end of a scan after {END_S:g} s: {self._line()}")
        self._count_alerts()
        if self._state() != "REVIEW":
            self._not_recorded(told, away)
            return
        if self._random.random() < KEEP:
            self._keep()
        else:
            self.report.rejected += 1
            for _ in range(REJECT_TRIES):  # a warning that lasts is acknowledged first, with the same key
                self.press("back", REJECT_HOLD_S)
                if self.until(lambda: self._state() != "REVIEW", PRESS_S) or self.over:
                    break

    def _not_recorded(self, told: list[str], away: str | None) -> None:
        """Count a scan that did not come about: somebody must say why, or have said it."""
        self._count_alerts()
        reason = next(iter(told), None) or self._reason(refused=False) or away
        if reason is None:
            self.report.unexplained.append(self._line())
        else:
            self.report.refused[reason] += 1

    def _keep(self) -> None:
        before = self.status().get("last_scan")
        self.press("scan")
        saved = self.until(lambda: self.status().get("last_scan") != before or self._shows("NOT_SAVED"), SAVE_S)
        if self._shows("NOT_SAVED") or not saved:
            self._count_alerts()
            self._repair()
            self.sleep(1.0)
            for _ in range(5):
                if self.status().get("last_scan") != before or self.over:
                    break
                self.press("scan")
                self.until(lambda: self.status().get("last_scan") != before, 10.0)
        after = self.status().get("last_scan")
        if after is not None and after != before:
            self.report.accepted.append(str(after))
        elif not self.over:
            self.report.unexplained.append(f"kept, but not saved: {self._line()}")

    # ------------------------------------------------------------------------------------- what is seen

    def _state(self) -> str | None:
        return self.status().get("state")

    def _aims(self) -> bool:
        return self._state() == "AIM"

    def _away(self) -> str | None:
        codes = [str(alert.get("code")) for alert in self.status().get("alerts") or []]
        return next((code for code in codes if code.endswith(LOST) and code != "SYNC_LOST"), None)

    def _shows(self, code: str) -> bool:
        return any(alert.get("code") == code for alert in self.status().get("alerts") or [])

    def _reason(self, *, refused: bool) -> str | None:
        """Return the code of the first alert, which is the newest message; ``refused``: only if it says so."""
        shown: list[Mapping[str, str]] = [a for a in self.status().get("alerts") or [] if a["code"] != "UNCALIBRATED"]
        if not shown or (refused and shown[0].get("action") != "SCAN REFUSED"):
            return None
        return shown[0].get("code")

    def _count_alerts(self) -> None:
        shown = {str(alert.get("code")) for alert in self.status().get("alerts") or []}
        self.report.alerts.update(shown - self._before)
        self._before = shown

    def _line(self) -> str:
        return f"scan {self.report.scans}, broken {self.world.broken}: {status_file.summary(self.status())}"
