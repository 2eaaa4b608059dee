"""Owns the page ``docs/screens.md``: every picture with what it shows."""

from __future__ import annotations

from pathlib import Path

from appliance.machine.alerts import RULES
from appliance.machine.words import Language
from tests.appliance.screens.golden.draw import Golden
from tests.appliance.screens.golden.scenes import ALERTS, SCENES

PAGE = Path(__file__).parents[4] / "docs" / "screens.md"
COMMAND = "./dev run python -m tests.appliance.screens.golden"
_HEAD = f"""# Screens

What the diver sees, at the display's own 800 × 480. Each picture is the one that the tests compare with
(`tests/appliance/screens/test_golden.py`); page and pictures are made by `{COMMAND}`, never by hand.

A display of 5 inches at arm's length, through a mask: the smallest capitals are 2.3 mm high, body type 2.9 mm, a headline
5.1 mm. Every letter has a contrast of 7:1 or more against what is really behind it, by luminance alone, so that it is read
in grey as well; words neither overlap nor are cut, in both languages, at 800 × 480, 1024 × 600 and 640 × 480
(`tests/appliance/screens/test_legible.py`). White is normal, solid yellow a warning, flashing red critical (1.5 Hz, below
the limit for photosensitive eyes). What each key does is written beside it: UP and DOWN on the left, SCAN and BACK on the
right. DOWN never turns the cloud in review: it is about the exposure, or does nothing. The language is chosen in the menu (LANGUAGE), each in its
own word; the rig file says which one the instrument comes with (`[display] language`).

One message leads a screen (`appliance/machine/leading.py`): the gravest, and among equally grave ones the one whose remedy comes first: what keeps it
dark, what forbids a scan, what spoilt it, then distance, other light, motion, water, exposure. All else is small, or grey. Where an alert or the distance leads, AIM does
not say READY, and a right distance is not green.

An alert has room of its own: numbers, rows and pictures move up, none is covered (`tests/appliance/screens/test_legible.py`). A
warning that lasts is acknowledged with BACK (SEEN) and stays as a small mark on every screen, until its reason changes or it
gets worse. What comes and goes with the live picture (too dark, too turbid, a torch on the object, too fast) stands in the place of READY, and as a
mark that says what to do: nothing jumps, and no key is needed. While the light is on nothing is drawn: the display and the projector share one thread and one graphics card, and a
picture of the progress could make a pattern late.
"""


def page() -> str:
    """The whole text."""
    lines = [_HEAD, "| English | German | |", "|---|---|---|"]
    lines += [f"| {_picture(name, False, 0)} | {_picture(name, False, 1)} | {s.says} |" for name, s in SCENES.items()]
    lines += ["", "## Alerts", ""]
    lines += [f"All {len(ALERTS)} of them, as the band that they take on any screen. What they mean and what to do:"]
    lines += ["[alarm list](operator/alarms.en.md), [Alarmliste](operator/alarms.de.md).", ""]
    lines += ["| code | English | German |", "|---|---|---|"]
    ranked = sorted(ALERTS, key=lambda code: -next(r.severity for c, r in RULES.items() if c.value == code))
    lines += [f"| {code} | {_picture(code, True, 0)} | {_picture(code, True, 1)} |" for code in ranked]
    return "\n".join(lines) + "\n"


def _picture(name: str, alert: bool, language: int) -> str:
    golden = Golden(name, tuple(Language)[language], alert)
    return f"![{name}](../tests/appliance/screens/golden/{golden.path.name})"
