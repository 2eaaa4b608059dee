"""Owns the texts of the operator's pages: alarm list and key map, in each language."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from appliance.machine import events as on
from appliance.machine.alerts import RULES, Severity
from appliance.machine.states import Machine, State
from appliance.machine.texts import labels
from appliance.machine.words import Label, Language, Text
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.grade import SPOILS_POINTS
from appliance.screens.frame import words_of
from appliance.screens.texts import worded
from drivers.api import Key
from tests.appliance.machine.walks import STARTS, armed, in_gallery, reviewing, run
from tests.appliance.screens.golden.scenes import ALERTS
from tests.appliance.screens.operator.meanings import MEANINGS

COMMAND = "./dev run python -m tests.appliance.screens.operator"
_SEVERITIES = {
    Severity.CRITICAL: ("Critical: flashing red", "Kritisch: rot blinkend"),
    Severity.WARNING: ("Warning: solid yellow", "Warnung: gelb"),
    Severity.INFO: ("For your information: white", "Zur Kenntnis: weiß"),
}
_ORDER = (Key.SCAN, Key.BACK, Key.UP, Key.DOWN)


def pick(language: Language, english: str, german: str) -> str:
    return german if language is Language.GERMAN else english


def alarms(language: Language) -> str:
    """The alarm list, the gravest first."""
    lines = [
        pick(language, "# Alarms", "# Alarme"),
        "",
        pick(
            language,
            f"Headline as on the screen (numbers are examples), what it means, what to do. Made by `{COMMAND}`.",
            f"Überschrift wie auf der Anzeige (Zahlen sind Beispiele), Bedeutung, was zu tun ist. Erzeugt mit `{COMMAND}`.",
        ),
    ]
    for severity in sorted(Severity, reverse=True):
        rows = [code for code, rule in RULES.items() if rule.severity is severity]
        head = pick(language, "| headline | meaning | do | effect |", "| Überschrift | Bedeutung | tun | Wirkung |")
        lines += ["", f"## {pick(language, *_SEVERITIES[severity])}", "", head, "|---|---|---|---|"]
        told = []
        for code in rows:
            headline, action = words_of(ALERTS[code.value], language)
            effect = _effect(code, language)
            told.append(f"| **{headline}** | {pick(language, *MEANINGS[code])} | {action} | {effect} |")
        lines += dict.fromkeys(told)  # what reads alike is one row
    lines += _overlaps(language)
    return "\n".join(lines) + "\n"


def _overlaps(language: Language) -> list[str]:
    """The words about many scans of one object, which are no alarms."""
    words = worded((Text.NO_OVERLAP, Text.GO_BACK), language), worded((Text.OVERLAP, "62 %"), language)
    none, some = (f"| **{said}** " for said in words)
    unsure = f"| **{worded(Text.OVERLAP_UNSURE, language)}** "
    return [
        "",
        pick(language, "## Many scans, one object", "## Viele Scans, ein Objekt"),
        "",
        pick(
            language,
            "OBJECT in the menu starts a numbered object, or ends it. After each scan the screen compares it with the one before.",
            "OBJEKT im Menü beginnt ein nummeriertes Objekt oder beendet es. Nach jedem Scan vergleicht ihn die Anzeige mit dem davor.",
        ),
        "",
        pick(language, "| words | meaning | do |", "| Worte | Bedeutung | tun |"),
        "|---|---|---|",
        some
        + pick(
            language,
            "| So much of this scan lies on the one before. | Half is good; below 25 % it is yellow: go on in smaller steps. |",
            "| So viel von diesem Scan liegt auf dem davor. | Die Hälfte ist gut; unter 25 % ist es gelb: in kleineren Schritten weiter. |",
        ),
        none
        + pick(
            language,
            "| Nothing joins this scan to the one before. | Scan again from half-way back. |",
            "| Nichts verbindet diesen Scan mit dem davor. | Auf halbem Weg zurück noch einmal scannen. |",
        ),
        unsure
        + pick(
            language,
            "| A smooth pipe or a grid looks alike everywhere. | Have a weld, a flange or a mark in both scans. |",
            "| Ein glattes Rohr oder ein Gitter sieht überall gleich aus. | Schweißnaht, Flansch oder Marke in beiden Scans haben. |",
        ),
        f"| **{worded((Text.OVERLAP, '25 %'), language)} · {worded(Text.TURN_BACK, language)}**, "
        f"**{worded((Text.OVERLAP, '80 %'), language)} · {worded(Text.GO_ON, language)}** "
        + pick(
            language,
            "| While aiming: so much would a scan from here have in common with the one that was kept. | Follow the arrow. |",
            "| Beim Zielen: So viel hätte ein Scan von hier mit dem behaltenen gemeinsam. | Dem Pfeil folgen. |",
        ),
        f"| **{worded((Text.OVERLAP, '50 %'), language)} · {worded(Text.SCAN_NOW, language)}** "
        + pick(language, "| Half is good. | Scan. |", "| Die Hälfte ist gut. | Scannen. |"),
        f"| **{worded(Text.TURN_BACK, language)}** "
        + pick(
            language,
            "| Nothing of the kept scan is in sight. | Go back to where it was taken. |",
            "| Vom behaltenen Scan ist nichts zu sehen. | Dorthin zurück, wo er gemacht wurde. |",
        ),
    ]


def _effect(code: FaultCode, language: Language) -> str:
    rule = RULES[code]
    said = (
        (rule.forbids_light, "no light", "kein Licht"),
        (rule.blocks_scan, "no scan while it lasts", "kein Scan, solange es dauert"),
        (rule.spoils_scan, "this scan is not used", "dieser Scan wird nicht verwendet"),
        (code in SPOILS_POINTS, "this scan is not called good", "dieser Scan gilt nicht als gut"),
    )
    return ", ".join(pick(language, english, german) for holds, english, german in said if holds)


ASKED = Text.POWER_OFF_ASKED.english
"""The row of the question, which is the same over every state."""


def meant() -> dict[str, dict[Key, list[Label]]]:
    """Every label that each key can have in each state, as the machine gives them; those of the question by ``ASKED``."""
    found: dict[str, dict[Key, list[Label]]] = defaultdict(lambda: defaultdict(list))
    for machine in (*(start() for start in STARTS), *_more()):
        row = found[machine.state.value if machine.off_question is None else ASKED]
        for key, word in labels(machine).items():
            if word not in row[key]:
                row[key].append(word)
    return found


def _more() -> Iterator[Machine]:
    """Moments that have labels of their own: an older scan, an exposure that is proposed, one that is added, a failed scan."""
    yield run(in_gallery(), on.KeyPressed(Key.DOWN))
    other = Exposure(8_000)
    yield run(reviewing(), on.Judged(1, (Fault(FaultCode.TOO_BRIGHT),), other))
    yield run(reviewing(), on.Judged(1, (), None, other))
    yield run(armed(), on.CaptureFailed(1, Fault(FaultCode.FRAME_MISSING)))


def keys(language: Language) -> str:
    """The key map: a row per screen."""
    found = meant()
    lines = [
        pick(language, "# Keys", "# Tasten"),
        "",
        pick(
            language,
            "One press has one meaning; its word stands on the display beside the key. HOLD means 0.8 s. "
            f"While a lasting warning is shown in full, BACK says {Text.SEEN.english} on every screen but while something is "
            "recorded: the press takes it for known and does nothing else, and a small mark of it stays. "
            f"A key without a word does nothing. Made by `{COMMAND}`.",
            "Ein Druck hat eine Bedeutung; ihr Wort steht auf der Anzeige neben der Taste. HALTEN heißt 0,8 s. "
            f"Solange eine bleibende Warnung groß dasteht, heißt BACK überall {Text.SEEN.german}, außer während einer Aufnahme: "
            "der Druck nimmt sie zur Kenntnis und tut sonst nichts, und eine kleine Marke bleibt. "
            f"Eine Taste ohne Wort tut nichts. Erzeugt mit `{COMMAND}`.",
        ),
        "",
        pick(language, "| upper left | lower left | upper right | lower right |", "| oben links | unten links | oben rechts | unten rechts |"),
        "|---|---|---|---|",
        "| UP | DOWN | SCAN / OK | BACK |",
        "",
        f"| {pick(language, 'screen', 'Bild')} | {' | '.join(key.name for key in _ORDER)} |",
        "|---|---|---|---|---|",
    ]  # fmt: skip
    for row in (*(state.value for state in State), ASKED):
        words = (", ".join(worded(word, language) for word in found.get(row, {}).get(key, [])) for key in _ORDER)
        lines.append(f"| {Text.POWER_OFF_ASKED.in_language(language) if row == ASKED else row} | {' | '.join(words)} |")
    return "\n".join(lines) + "\n"


def index() -> str:
    """The folder's first page."""
    return f"""# For the operator

| | English | Deutsch |
|---|---|---|
| dive card, A5, to print and laminate | [picture](dive-card.en.png) | [Bild](dive-card.de.png) |
| key map | [keys](keys.en.md) | [Tasten](keys.de.md) |
| alarm list | [alarms](alarms.en.md) | [Alarme](alarms.de.md) |
| all screens | [screens](../screens.md) | |
| taking scans to a desk | [transfer](transfer.en.md) | [Übertragung](transfer.de.md) |

All of it but the last is made from the instrument's own tables by `{COMMAND}`; a test notices when it no longer says what the
instrument does. The card is 148 × 210 mm at 300 px per inch.
"""
