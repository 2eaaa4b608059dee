"""Owns the diver's words for every fault: one row each, and the list to show at a moment.

A headline has at most 16 characters, an action at most 32; both are read under water, in grey.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import MappingProxyType

from appliance.machine import german
from appliance.machine.states import Machine, NoticeKind, State
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key


class Severity(IntEnum):
    """As dive computers show it: white, solid yellow, flashing red."""

    INFO = 0
    WARNING = 1
    CRITICAL = 2


@dataclass(frozen=True, slots=True)
class Alert:
    """One message as it is shown. ``detail`` is for the log and for a technician."""

    code: FaultCode
    severity: Severity
    headline: str
    action: str
    detail: str = ""
    device: str | None = None
    german: tuple[str, str] | None = None
    """Headline and action in German; ``None``: only English is known."""
    lasts: bool = False
    """Shown as long as its cause lasts (a condition, a lost device, a stuck key), not until the next key."""
    passing: bool = False
    """As in ``Rule``."""
    seen: bool = False
    """The diver has acknowledged it: a small mark is left of it."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A row of the table. ``headline`` is used when all its numbers are known, else ``plain``."""

    severity: Severity
    headline: str
    action: str
    plain: str = ""
    exchanged: str = ""
    """Instead of ``action``, with the camera's name, where the fault names a camera."""
    blocks_scan: bool = False
    """While it lasts, SCAN is refused."""
    stops_capture: bool = False
    """When it comes during a capture, the capture ends."""
    forbids_light: bool = False
    """While it lasts, neither projector nor lasers may shine."""
    spoils_scan: bool = False
    """Found in a recorded scan, it makes the scan worthless."""
    spoils_points: bool = False
    """Found in a recorded scan, it makes points wrong: the diver may keep the scan, but is never told it is good."""
    doubts_lengths: bool = False
    """While it lasts, shapes are right and lengths may not be: no scan is called good without saying so."""
    passing: bool = False
    """It comes and goes with the live picture: told in the title and as a mark that says what to do, never in full. Nothing
    moves under the diver's eyes, and no key is needed."""
    worsens: Mapping[str, float] = field(default_factory=dict, hash=False)
    """By how much a number has to change, and in which direction, for an acknowledged alert to be shown in full again."""


_I, _W, _C = Severity.INFO, Severity.WARNING, Severity.CRITICAL
_INCOMPLETE = "INCOMPLETE {received:.0f}/{expected:.0f}"

RULES: Mapping[FaultCode, Rule] = MappingProxyType(
    {
        FaultCode.FRAME_MISSING: Rule(_W, _INCOMPLETE, "REPEAT", "INCOMPLETE", spoils_scan=True),
        FaultCode.FRAME_REPEATED: Rule(_W, _INCOMPLETE, "REPEAT", "FRAME REPEATED", spoils_scan=True),
        FaultCode.FRAME_ORDER: Rule(_W, _INCOMPLETE, "REPEAT", "FRAME ORDER", spoils_scan=True),
        FaultCode.FRAME_TRUNCATED: Rule(_W, _INCOMPLETE, "REPEAT", "FRAME CUT SHORT", spoils_scan=True),
        FaultCode.FRAME_CORRUPT: Rule(_W, _INCOMPLETE, "REPEAT", "FRAME DAMAGED", spoils_scan=True),
        FaultCode.CAMERA_STUCK: Rule(_W, "{side}CAM STUCK", "REPEAT", "CAMERA STUCK", spoils_scan=True),
        FaultCode.PATTERN_WRONG: Rule(_W, "WRONG PATTERN", "REPEAT", spoils_scan=True),
        FaultCode.SYNC_LOST: Rule(_W, "SYNC LOST", "REPEAT; CHECK TRIGGER CABLES", spoils_scan=True),
        FaultCode.LATE_FLIP: Rule(_W, "PROJECTOR LATE", "REPEAT", spoils_scan=True),
        FaultCode.PROJECTOR_TIMING: Rule(_W, "PROJECTOR TIMING", "REPEAT; RESTART IF AGAIN", spoils_scan=True),
        FaultCode.PROJECTOR_DARK: Rule(_W, "PROJECTOR DARK", "CHECK LAMP AND VIDEO CABLE", spoils_scan=True),
        FaultCode.PULSE_MISSING: Rule(
            _W, "PULSES {received:.0f}/{expected:.0f}", "REPEAT", "PULSE MISSING", spoils_scan=True
        ),
        FaultCode.CAPTURE_TIMEOUT: Rule(_W, "SCAN TIMED OUT", "REPEAT", spoils_scan=True),
        FaultCode.MOVED: Rule(_W, "MOVED {shift_px:.1f} px", "REPEAT", "MOVED", spoils_points=True),
        FaultCode.COMPENSATED: Rule(_I, "MOTION CORRECTED", "KEEP, OR REPEAT HELD STILL"),
        FaultCode.TOO_BRIGHT: Rule(_W, "TOO BRIGHT", "SHORTEN EXPOSURE, REPEAT"),
        FaultCode.TOO_DARK: Rule(_W, "TOO DARK", "GO CLOSER OR LENGTHEN EXPOSURE"),
        FaultCode.WATER_DIRTY: Rule(
            _W, "WATER DIRTY {coverage_percent:.0f}%", "LET IT SETTLE OR GO CLOSER", "WATER DIRTY"
        ),
        FaultCode.SCAN_NEAR: Rule(_W, "NEAR {distance_mm:.0f} mm", "BACK, REPEAT", "TOO NEAR"),
        FaultCode.SCAN_FAR: Rule(_W, "FAR {distance_mm:.0f} mm", "GO CLOSER, REPEAT", "TOO FAR"),
        FaultCode.NOTHING_SEEN: Rule(_W, "NOTHING SEEN", "GO CLOSER; IS LIGHT COVERED?"),
        FaultCode.SCAN_POOR: Rule(_W, "POOR, CAUSE ?", "GO CLOSER, HOLD STILL, REPEAT"),
        FaultCode.LIGHT_FLICKERS: Rule(_W, "LIGHT FLICKERS", "SHADE OR MOVE AWAY, REPEAT", spoils_points=True),
        FaultCode.AMBIENT: Rule(_W, "TOO MUCH LIGHT", "SHADE IT, TURN TORCHES AWAY"),
        FaultCode.CAMERA_LOST: Rule(
            _W, "{side}CAM LOST", "CHECK CONNECTOR", "CAMERA LOST", blocks_scan=True, stops_capture=True
        ),
        FaultCode.CAMERA_SLOW_LINK: Rule(
            _W, "CAMERA LINK SLOW", "CHECK CONNECTOR", blocks_scan=True, stops_capture=True
        ),
        FaultCode.CAMERA_REFUSED: Rule(
            _W, "{side}CAM REFUSED", "ASHORE: CHECK RIG FILE", "CAMERA REFUSED", blocks_scan=True, stops_capture=True
        ),
        FaultCode.PROJECTOR_LOST: Rule(_W, "PROJECTOR LOST", "CHECK CONNECTOR", blocks_scan=True, stops_capture=True),
        FaultCode.DISPLAY_LOST: Rule(_W, "DISPLAY LOST", "CHECK CONNECTOR"),
        FaultCode.BOARD_LOST: Rule(_W, "BOARD LOST", "CHECK CONNECTOR", blocks_scan=True, stops_capture=True),
        FaultCode.BOARD_RESET: Rule(_W, "BOARD RESET", "REPEAT IF A SCAN WAS RUNNING", spoils_scan=True),
        FaultCode.VSYNC_LOST: Rule(_W, "NO VIDEO SIGNAL", "CHECK VIDEO CABLE", blocks_scan=True, stops_capture=True),
        FaultCode.LASER_ON: Rule(_C, "LASER ON", "SCAN BLOCKED", blocks_scan=True, stops_capture=True),
        FaultCode.LASER_FAILED: Rule(_W, "LASER OUT", "DISTANCE FROM ONE DOT"),
        FaultCode.KEYS_LOST: Rule(_W, "KEYS LOST", "CHECK CONNECTOR"),
        FaultCode.KEY_STUCK: Rule(_W, "KEY STUCK", "USE THE KEY WITH ITS LABEL"),
        FaultCode.TOO_NEAR: Rule(_W, "NEAR {distance_mm:.0f} mm", "BACK, OR SCAN AGAIN TO RECORD", "TOO NEAR"),
        FaultCode.TOO_FAR: Rule(_W, "FAR {distance_mm:.0f} mm", "CLOSER, OR SCAN AGAIN TO RECORD", "TOO FAR"),
        FaultCode.AIM_DARK: Rule(_W, "TOO DARK TO SCAN", "GO CLOSER OR LENGTHEN EXPOSURE", passing=True),
        FaultCode.AIM_TURBID: Rule(_W, "WATER TOO TURBID", "GO CLOSER OR LET IT SETTLE", passing=True),
        FaultCode.AIM_FAST: Rule(_W, "MOVING TOO FAST", "HOLD STILL, THEN SCAN", passing=True),
        FaultCode.STORAGE_FULL: Rule(_W, "STORAGE FULL", "COPY SCANS, MAKE ROOM", blocks_scan=True),
        FaultCode.DISK_READ_ONLY: Rule(_W, "DISK READ-ONLY", "END DIVE, DISK NEEDS SERVICE", blocks_scan=True),
        FaultCode.DISK_REFUSES: Rule(_W, "DISK REFUSES", "END DIVE, DISK NEEDS SERVICE", blocks_scan=True),
        FaultCode.NOT_SAVED: Rule(_C, "NOT SAVED", "TRY AGAIN OR REPEAT"),
        FaultCode.RESTARTED: Rule(_W, "RESTARTED", "GO ON; SAVED SCANS ARE THERE"),
        FaultCode.SCAN_RECOVERED: Rule(_W, "SCAN RECOVERED", "IT IS IN THE GALLERY"),
        FaultCode.UPDATE_UNDONE: Rule(_W, "UPDATE UNDONE", "THE OLD VERSION GOES ON"),
        FaultCode.SETTINGS_LOST: Rule(_W, "SETTINGS LOST", "CHECK THEM IN THE MENU"),
        FaultCode.UNCALIBRATED: Rule(
            _W, "UNCALIBRATED", "LENGTHS NOT TRUSTED", doubts_lengths=True, exchanged="{camera} EXCHANGED"
        ),
        FaultCode.LENGTH_ERROR: Rule(
            _W,
            "LENGTH ERR {error_percent:.1f} %",
            "CHECK WATER, THEN CALIBRATE",
            "LENGTH ERROR",
            doubts_lengths=True,
            worsens={"error_percent": 0.2},
        ),
        FaultCode.VERIFY_CALIBRATION: Rule(_W, "VERIFY CALIBR.", "CHECK WATER AND BALL BAR", doubts_lengths=True),
        FaultCode.RECONSTRUCTION_FAILED: Rule(_W, "PROCESS LATER", "KEEP RAW FRAMES OR REPEAT"),
        FaultCode.WINDOW: Rule(_W, "{side}WINDOW?", "WIPE IT; FOG INSIDE: DRY IT", "WINDOW?"),
        FaultCode.WARM: Rule(
            _W, "WARM {temperature_c:.0f} °C", "LET IT COOL SOON", "WARM", worsens={"temperature_c": 2.0}
        ),
        FaultCode.HOT: Rule(
            _C, "HOT {temperature_c:.0f} °C", "COOLING, SCAN BLOCKED", "HOT", blocks_scan=True, forbids_light=True
        ),
        FaultCode.TOO_HOT: Rule(
            _C, "TOO HOT {temperature_c:.0f}°C", "SWITCHING OFF", "TOO HOT", blocks_scan=True, forbids_light=True
        ),
        FaultCode.TEMPERATURE_UNKNOWN: Rule(_W, "TEMP ?", "LIGHT IS RATIONED"),
        FaultCode.SUPPLY_LOW: Rule(
            _W, "SUPPLY LOW {supply_v:.1f}V", "END DIVE", "SUPPLY LOW", blocks_scan=True, worsens={"supply_v": -0.3}
        ),
        FaultCode.LEAK: Rule(_C, "LEAK: ASCEND", "LIGHT IS OFF, SCANS ARE SAFE", blocks_scan=True, forbids_light=True),
        FaultCode.INTERNAL: Rule(_W, "INTERNAL FAULT", "REPEAT; READ THE LOG ASHORE", spoils_scan=True),
    }
)

_CAMERAS = {"camera.left": "LEFT CAMERA", "camera.right": "RIGHT CAMERA", "cameras": "CAMERAS"}
LONGEST = 16
"""Letters of a headline; ``plain`` has no more either."""
_SIDES = {"camera.left": "LEFT ", "camera.right": "RIGHT "}


def headline_of(fault: Fault) -> str:
    """At most 16 characters, with the fault's numbers where all of them are known."""
    rule = RULES[fault.code]
    return _filled(rule.headline, rule.plain or fault.code.value.replace("_", " "), fault, {"side": _SIDES}, LONGEST)


def actions_of(fault: Fault) -> tuple[str, str]:
    """What to do, or what the fault costs, in English and German; where a camera was exchanged, which one."""
    rule, words = RULES[fault.code], german.GERMAN[fault.code]
    if fault.device is None or not rule.exchanged or fault.device not in _CAMERAS:
        return rule.action, words.action
    in_german = words.exchanged.format(camera=german.CAMERAS[fault.device])
    return rule.exchanged.format(camera=_CAMERAS[fault.device]), in_german


def german_headline_of(fault: Fault) -> str:
    """The same in German."""
    words = german.GERMAN[fault.code]
    sides = {"side": german.SIDES, "window_side": german.WINDOW_SIDES}
    return _filled(words.headline, words.plain or words.headline, fault, sides, german.LONGEST)


def _filled(template: str, plain: str, fault: Fault, sides: Mapping[str, Mapping[str, str]], longest: int) -> str:
    """The template with the fault's numbers; ``plain`` where one is missing, or so large that there is no room for it."""
    values: dict[str, float | str] = dict(fault.numbers)
    for name, words in sides.items():
        if fault.device is not None and fault.device in words:
            values[name] = words[fault.device]
    try:
        text = template.format(**values)
    except (KeyError, ValueError):
        text = plain
    return text if len(text) <= longest else plain


def alert_of(fault: Fault) -> Alert:
    """The fault as a message of its own."""
    rule = RULES[fault.code]
    action, german_action = actions_of(fault)
    in_german = german_headline_of(fault), german_action
    return Alert(
        fault.code,
        rule.severity,
        headline_of(fault),
        action,
        fault.detail,
        fault.device,
        in_german,
        passing=rule.passing,
    )


def _notice(machine: Machine) -> Alert | None:
    if machine.notice is None:
        return None
    fault = machine.notice.fault
    rule = RULES[fault.code]
    plain = alert_of(fault)
    in_german = german_headline_of(fault)
    match machine.notice.kind:
        case NoticeKind.REFUSAL:
            return replace(plain, action="SCAN REFUSED", german=(in_german, german.REFUSED))
        case NoticeKind.NOT_ADDED:
            return replace(
                plain, headline="NOT ADDED", action=f"{plain.headline}: FIRST KEPT",
                german=(german.NOT_ADDED, f"{in_german}: {german.FIRST_KEPT}"),
            )  # fmt: skip
        case NoticeKind.FAILURE if rule.stops_capture or rule.forbids_light:
            # What ended the scan is listed as a condition while it lasts; this says what became of the scan.
            return replace(
                plain, headline="SCAN FAILED", action=f"{plain.headline}: REPEAT",
                german=(german.FAILED, f"{in_german}: {german.AGAIN}"),
            )  # fmt: skip
        case NoticeKind.FAILURE | NoticeKind.NEWS:
            return plain


_TESTED = frozenset(
    {
        FaultCode.CAMERA_LOST, FaultCode.CAMERA_SLOW_LINK, FaultCode.CAMERA_REFUSED, FaultCode.PROJECTOR_LOST,
        FaultCode.DISPLAY_LOST, FaultCode.BOARD_LOST, FaultCode.KEYS_LOST, FaultCode.UNCALIBRATED,
    }
)  # fmt: skip
"""What has a line of its own in the self-test."""
QUIET: Mapping[State, frozenset[FaultCode]] = MappingProxyType(
    {
        State.BOOT: _TESTED,
        State.SELF_TEST: _TESTED,
        State.CALIBRATE: frozenset({FaultCode.UNCALIBRATED, FaultCode.LENGTH_ERROR}),
        State.COOLING: frozenset({FaultCode.HOT, FaultCode.WARM}),
        State.SAFE: frozenset({FaultCode.LEAK}),
    }
)
"""What a state's own screen says already, or is the remedy for."""


def lasting(machine: Machine) -> tuple[Fault, ...]:
    """What is wrong until it ends by itself or is mended: lost devices, conditions, stuck keys."""
    stuck = (Fault(FaultCode.KEY_STUCK, f"{k.value} key", device=f"key.{k.value}") for k in Key if k in machine.stuck)
    return (*machine.lost.values(), *machine.conditions, *stuck)


def seen(machine: Machine, fault: Fault) -> bool:
    """Whether the diver has acknowledged it as it is now: for the same reason, and not noticeably worse."""
    worsens = RULES[fault.code].worsens
    return any(
        (was.code, was.device, _reason(was)) == (fault.code, fault.device, _reason(fault))
        and not any(_worse(was, fault, name, by) for name, by in worsens.items())
        for was in machine.seen
    )


def _reason(fault: Fault) -> str:
    """The detail without its numbers, which change from one moment to the next."""
    return re.sub(r"[-+]?\d[\d.,]*", "#", fault.detail)


def _worse(was: Fault, now: Fault, name: str, by: float) -> bool:
    if name not in was.numbers or name not in now.numbers:
        return name in now.numbers
    change = now.numbers[name] - was.numbers[name]
    return change >= by if by > 0.0 else change <= by


def in_full(shown: Sequence[Alert]) -> Alert | None:
    """The one that is shown in full: the first of the gravest that nobody has acknowledged."""
    return max(
        (alert for alert in shown if not alert.seen and not alert.passing),
        key=lambda alert: alert.severity,
        default=None,
    )


def on_screen(machine: Machine) -> tuple[Alert, ...]:
    """What the band of the screen shows of ``alerts``: not what the screen is made of, nor what is being remedied."""
    quiet = QUIET.get(machine.state, frozenset())
    return tuple(alert for alert in alerts(machine) if alert.code not in quiet)


def lengths_doubtful(machine: Machine) -> bool:
    """Whether something lasts that makes lengths not to be trusted."""
    return any(RULES[fault.code].doubts_lengths for fault in machine.conditions)


def alerts(machine: Machine) -> tuple[Alert, ...]:
    """What to show now: the notice first, then what lasts, the most severe first; nothing twice."""
    lasts = [replace(alert_of(fault), lasts=True, seen=seen(machine, fault)) for fault in lasting(machine)]
    if machine.scan is not None:
        lasts += [alert_of(fault) for fault in machine.scan.warnings]
        if machine.scan.failed is not None:
            lasts.append(alert_of(machine.scan.failed))
    # Among equally grave ones, what keeps it dark comes first, then what forbids a scan: a leak before a disk, and a full
    # disk before a calibration that nobody trusts.
    lasts.sort(key=lambda a: (-a.severity, not RULES[a.code].forbids_light, not RULES[a.code].blocks_scan))
    shown: list[Alert] = []
    notice = _notice(machine)
    if notice is not None:
        shown.append(notice)
    for alert in lasts:
        if not any((s.code, s.headline) == (alert.code, alert.headline) for s in shown):
            shown.append(alert)
    return tuple(shown)
