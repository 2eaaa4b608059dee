"""A dive with random failures: devices are removed and returned in random order while the diver scans.

The diver knows the instrument through its status file, as a real one through the screen: he scans, keeps or repeats
scans, always goes back to AIM, and records the alerts. The same seed gives the same failures and decisions; the results
depend on the computer's speed.
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
"""Number of frames of the shortest sequence, so that a fault in one of them occurs with any period."""
AIM_S, ANSWER_S, END_S, SAVE_S = 60.0, 3.0, 200.0, 60.0
"""Longest waits of world time: for AIM, for an effect of a key, for the end of a scan, for a save."""
LOST = "_LOST"
"""End of the codes of missing devices."""
REJECT_HOLD_S = 1.2
REJECT_TRIES = 5
"""Number of presses of BACK to reject a scan."""
READY_S = 45.0
"""Longest wait, after all repairs, until SCAN starts a scan."""
BREAK, GIVE_BACK, KEEP, BREAK_COMPUTER = 0.5, 0.75, 0.8, 0.06
"""Probabilities: of a failure before a scan, of repair, of keeping a scan, and of a failure of the computer."""


@dataclass(slots=True)
class Report:
    """The record of one dive."""

    seed: int
    scans: int = 0
    """Number of presses of SCAN."""
    accepted: list[str] = field(default_factory=list)
    """Numbers of the scans that the screen reported as saved."""
    rejected: int = 0
    """Number of scans that the diver rejected."""
    refused: Counter[str] = field(default_factory=Counter)
    """Number of scans that were not recorded or worthless, by the code on the screen."""
    unexplained: list[str] = field(default_factory=list)
    """Failed scans without an alert."""
    alerts: Counter[str] = field(default_factory=Counter)
    """Number of occurrences of each alert."""
    broken: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the record ready for JSON."""
        return {
            "seed": self.seed, "scans": self.scans, "accepted": self.accepted, "rejected": self.rejected,
            "refused": dict(self.refused), "unexplained": self.unexplained, "alerts": dict(self.alerts),
            "broken": self.broken,
        }  # fmt: skip


class ChaosDiver(Operator):
    """Presses SCAN ``scans`` times during failures; always writes ``report`` (JSON) at the end."""

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
        # The draws of a seed do not depend on the instrument's answers.
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
            return  # there is no process now, or it has failed already
        self._disk_off = self._disk_off or what == ("disk", "off")
        self.report.broken.append(" ".join(what))

    def _repair(self) -> None:
        self.world.clear_faults()
        if self._disk_off:
            computer.happen(("disk", "on"), self.status_path)
            self._disk_off = False

    # ------------------------------------------------------------------------------------- one scan

    def _to_aim(self) -> None:
        """Return to AIM as a diver does: with BACK, and by waiting if only time helps."""
        if self.until(self._aims, 1.0) or self.over:
            return
        for tries in range(int(AIM_S)):
            # After this time the diver surfaces: the failure does not repair itself.
            if tries == 20:
                self._repair()  # the keypad or the disk may be missing
            # BACK is held only in REVIEW: elsewhere that might switch off.
            self.press("back", REJECT_HOLD_S if self._state() == "REVIEW" else PRESS_S)
            if self.until(self._aims, 1.0) or self.over:
                return
        raise OperatorError(f"BACK does not lead to AIM: {self._line()}")

    def _scan_once(self) -> None:
        """Press SCAN once, and record the result."""
        self.report.scans += 1
        reported_codes: list[str] = []
        """Reasons of a refusal, as soon as they are to be seen: they go when what they name comes back."""
        away = self._away()
        """The device that the screen calls lost: a reason for nothing to happen, even if it comes back right then."""

        def answered() -> bool:
            """Return True if SCAN was answered. A change of alerts is no answer: a device may have just come back."""
            reported_codes.extend(filter(None, [self._reason(refused=True)]))
            return bool(reported_codes) or not self._aims()

        self.world.press("scan")
        if not self.until(answered, ANSWER_S) or reported_codes:
            self._not_recorded(reported_codes, away)
            return
        if not self.until(lambda: self._state() in ("REVIEW", "AIM", None), END_S):
            raise OperatorError(f"no end of a scan after {END_S:g} s: {self._line()}")
        self._count_alerts()
        if self._state() != "REVIEW":
            self._not_recorded(reported_codes, away)
            return
        if self._random.random() < KEEP:
            self._keep()
        else:
            self.report.rejected += 1
            for _ in range(REJECT_TRIES):  # the same key first acknowledges a lasting warning
                self.press("back", REJECT_HOLD_S)
                if self.until(lambda: self._state() != "REVIEW", PRESS_S) or self.over:
                    break

    def _not_recorded(self, reported_codes: list[str], away: str | None) -> None:
        """Count a scan that failed; an alert must state the reason."""
        self._count_alerts()
        reason = next(iter(reported_codes), None) or self._reason(refused=False) or away
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
