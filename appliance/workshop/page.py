"""Owns the pages of the bring-up: everything that whoever helps from afar would ask for, in one file."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from appliance.measure import PAGE_END, figure, page_head, rows, table
from appliance.workshop.finding import Finding
from appliance.workshop.kept import GuideState, StepRecord
from appliance.workshop.step import GuideStep, StepOutcome

_STYLE = (
    "<style>.good{color:#06602a;font-weight:bold}.yet{color:#777}"
    "pre{background:#f5f5f2;border:1px solid #bbb;padding:.8em;overflow-x:auto;font-size:.85em}"
    "td{vertical-align:top}body{max-width:74em}h2{margin-top:1.8em;border-bottom:1px solid #bbb}"
    ".next{border-left:4px solid #a00;padding:.2em "
    "1em;background:#fbf3f2}.next.done{border-color:#06602a;background:#f1f7f2}</style>"
)
_WORDS = {"WRONG": "no", "good": "good", "not yet": "yet"}
"""Class of each word that a table marks."""


def guide_page(state: GuideState, steps: Sequence[GuideStep], rig_text: str, pictures: Mapping[str, bytes]) -> str:
    """Return the page about a guided bring-up as HTML.

    ``pictures`` are PNG by the name that the state has; one that is missing is left out.
    """
    title = page_head("Kingfisher: from a box of parts to the first plane")
    parts = [title, _STYLE, _next(state, steps), _summary(state, steps)]
    for number, step in enumerate(steps, 1):
        record = state.steps.get(step.name)
        if record is not None:
            parts.append(_step(number, step, record, pictures))
    # Last, since it is long and only wanted where the findings leave something open.
    for heading, lines in state.about.items():
        parts.append(f"<h2>{html.escape(heading)}</h2><pre>{html.escape(chr(10).join(lines) or 'nothing')}</pre>")
    parts.append(
        f"<h2>The rig file</h2><p>{html.escape(state.rig_file)}, sha256 {html.escape(state.rig_sha256)}</p>"
        f"<pre>{html.escape(rig_text)}</pre>"
    )
    return "".join(parts) + PAGE_END


def outcomes_page(title: str, findings: Sequence[Finding], outcomes: Sequence[StepOutcome]) -> str:
    """Return a page about steps that were done outside of the guide as HTML; ``findings`` are theirs, and all pictures
    are in it."""
    parts = [page_head(title), _findings_table(findings)]
    keys = {f"[{place.table}] {place.key}": value for one in outcomes for place, value in one.keys.items()}
    if keys:
        parts.append("<h2>Keys of the rig file</h2>" + table(keys))
    drawn = [figure(caption, data) for one in outcomes for caption, data in one.pictures.values()]
    parts.append("<h2>What was seen</h2>" + "".join(drawn))
    parts += [f"<h2>{heading}</h2>{rows(content)}" for one in outcomes for heading, content in one.tables.items()]
    return "".join(parts) + PAGE_END


def _findings_table(findings: Sequence[Finding]) -> str:
    # Columns that would be empty are left out: the page is read on small screens, too.
    limits, remedies = any(one.limits for one in findings), any(one.remedy for one in findings)
    lines = [
        {
            "": "good" if one.ok else "WRONG",
            "check": one.name,
            "seen": one.said,
            **({"limits": one.limits} if limits else {}),
            **({"do": one.remedy or None} if remedies else {}),
        }
        for one in findings
    ]
    return _marked(rows(lines), "WRONG")


def _marked(table_html: str, *words: str) -> str:
    """Mark the cells that hold one of our words; their text was escaped before."""
    for word in words:
        table_html = table_html.replace(f"<td>{word}</td>", f'<td class="{_WORDS[word]}">{word}</td>')
    return table_html


def _next(state: GuideState, steps: Sequence[GuideStep]) -> str:
    """Return what is to be done now, in words: whoever opens the page wants that first."""
    for step in steps:
        record, title = state.steps.get(step.name), html.escape(step.title.lower())
        if record is None:
            return f'<p class="next">Next: <b>{step.name}</b>, {title}.</p>'
        if not record.good:
            wrong = "".join(
                f"<li><b>{html.escape(one.name)}</b>: {html.escape(one.said)}. Do: {html.escape(one.remedy)}.</li>"
                for one in record.findings
                if not one.ok
            )
            return f'<div class="next"><p>Stopped at <b>{step.name}</b>, {title}:</p><ul>{wrong}</ul></div>'
    return f'<p class="next done">All {len(steps)} steps are good. Next: calibrate (docs/calibration.md).</p>'


def _summary(state: GuideState, steps: Sequence[GuideStep]) -> str:
    lines = []
    for number, step in enumerate(steps, 1):
        record = state.steps.get(step.name)
        lines.append(
            {
                "": number,
                "step": step.name,
                "what": step.title,
                "is": "not yet" if record is None else "good" if record.good else "WRONG",
                "when": None if record is None else record.when,
                "took": None if record is None else f"{record.duration_s:.0f} s",
            }
        )
    table_html = rows(lines)
    for name in state.steps:
        table_html = table_html.replace(f"<td>{name}</td>", f'<td><a href="#{name}">{name}</a></td>')
    return _marked(table_html, *_WORDS)


def _step(number: int, step: GuideStep, record: StepRecord, pictures: Mapping[str, bytes]) -> str:
    word = '<span class="good">good</span>' if record.good else '<span class="no">WRONG</span>'
    parts = [f'<h2 id="{step.name}">{number}. {html.escape(step.title)} ({step.name}): {word}</h2>']
    if record.findings:
        parts.append(_findings_table(record.findings))
        # Sentences round their numbers; whoever helps wants all digits.
        numbers = [
            {"number": f"{one.name}: {name}", "value": value}
            for one in record.findings
            for name, value in one.numbers.items()
        ]
        if numbers:
            parts.append(f"<details><summary>all numbers</summary>{rows(numbers)}</details>")
    if record.written:
        parts.append("<h3>Written into the rig file</h3>" + table(record.written))
    for title, content in record.tables.items():
        if content:
            parts.append(f"<details open><summary>{html.escape(title)}</summary>{rows(content)}</details>")
    parts += [figure(caption, pictures[name]) for name, caption in record.pictures.items() if name in pictures]
    return "".join(parts)
