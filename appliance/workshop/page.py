"""HTML pages of the bring-up, each with all that a remote helper needs, in one file."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from appliance.base import Html, Page
from appliance.workshop.finding import Finding
from appliance.workshop.kept import GuideState, StepRecord
from appliance.workshop.step import GuideStep, StepOutcome

_WORDS = {"WRONG": "no", "good": "good", "not yet": "yet"}
"""Class of each word that a table marks."""


def guide_page(state: GuideState, steps: Sequence[GuideStep], rig_text: str, pictures: Mapping[str, bytes]) -> str:
    """Return the page about a guided bring-up as HTML.

    ``pictures`` are PNG by the name that the state has; missing ones are left out.
    """
    page = Page("Kingfisher: from a box of parts to the first plane")
    page.add(_next(state, steps))
    page.rows([_line(number, step, state) for number, step in enumerate(steps, 1)], _WORDS)
    for number, step in enumerate(steps, 1):
        record = state.steps.get(step.name)
        if record is not None:
            _add_step(page, number, step, record, pictures)
    # Last, since it is long and needed only where the findings are not conclusive.
    for heading, lines in state.about.items():
        page.heading(heading)
        page.add(f"<pre>{html.escape(chr(10).join(lines) or 'nothing')}</pre>")
    page.heading("The rig file")
    page.note(f"{state.rig_file}, sha256 {state.rig_sha256}")
    page.add(f"<pre>{html.escape(rig_text)}</pre>")
    return page.as_html()


def outcomes_page(title: str, findings: Sequence[Finding], outcomes: Sequence[StepOutcome]) -> str:
    """Return a page about steps that were done outside of the guide as HTML.

    It has their ``findings`` and all their pictures.
    """
    page = Page(title)
    _add_findings(page, findings)
    keys = {f"[{place.table}] {place.key}": value for outcome in outcomes for place, value in outcome.keys.items()}
    if keys:
        page.heading("Keys of the rig file")
        page.facts(keys)
    page.heading("Findings")
    for outcome in outcomes:
        for caption, data in outcome.pictures.values():
            page.figure(caption, data)
    for outcome in outcomes:
        for heading, content in outcome.tables.items():
            page.heading(heading)
            page.rows(content)
    return page.as_html()


def _add_findings(page: Page, findings: Sequence[Finding]) -> None:
    # Columns that would be empty are left out: the page is read on small screens, too.
    limits, remedies = any(finding.limits for finding in findings), any(finding.remedy for finding in findings)
    page.rows(
        [
            {
                "": "good" if finding.ok else "WRONG",
                "check": finding.name,
                "seen": finding.said,
                **({"limits": finding.limits} if limits else {}),
                **({"do": finding.remedy or None} if remedies else {}),
            }
            for finding in findings
        ],
        {"WRONG": "no"},
    )


def _next(state: GuideState, steps: Sequence[GuideStep]) -> str:
    """Return the next thing to do, in words: it comes first on the page."""
    for step in steps:
        record, title = state.steps.get(step.name), html.escape(step.title.lower())
        if record is None:
            return f'<p class="next">Next: <b>{step.name}</b>, {title}.</p>'
        if not record.good:
            wrong = "".join(
                f"<li><b>{html.escape(finding.name)}</b>: {html.escape(finding.said)}. Do: {html.escape(finding.remedy)}.</li>"
                for finding in record.findings
                if not finding.ok
            )
            return f'<div class="next"><p>Stopped at <b>{step.name}</b>, {title}:</p><ul>{wrong}</ul></div>'
    return f'<p class="next done">All {len(steps)} steps are good. Next: calibrate (docs/calibration.md).</p>'


def _line(number: int, step: GuideStep, state: GuideState) -> dict[str, object]:
    record = state.steps.get(step.name)
    return {
        "": number,
        "step": step.name if record is None else Html(f'<a href="#{step.name}">{step.name}</a>'),
        "what": step.title,
        "is": "not yet" if record is None else "good" if record.good else "WRONG",
        "when": None if record is None else record.when,
        "took": None if record is None else f"{record.duration_s:.0f} s",
    }


def _add_step(page: Page, number: int, step: GuideStep, record: StepRecord, pictures: Mapping[str, bytes]) -> None:
    page.heading(f"{number}. {step.title} ({step.name}): {'good' if record.good else 'WRONG'}", step.name)
    if record.findings:
        _add_findings(page, record.findings)
        # Sentences round their numbers; a helper needs all digits.
        numbers = [
            {"number": f"{finding.name}: {name}", "value": value}
            for finding in record.findings
            for name, value in finding.numbers.items()
        ]
        if numbers:
            _add_details(page, "all numbers", numbers, opened=False)
    if record.written:
        page.add("<h3>Written into the rig file</h3>")
        page.facts(record.written)
    for title, content in record.tables.items():
        if content:
            _add_details(page, title, content, opened=True)
    for name, caption in record.pictures.items():
        if name in pictures:
            page.figure(caption, pictures[name])


def _add_details(page: Page, title: str, content: Sequence[Mapping[str, object]], *, opened: bool) -> None:
    page.add(f"<details{' open' if opened else ''}><summary>{html.escape(title)}</summary>")
    page.rows(content)
    page.add("</details>")


def side_by_side(name: str, columns: Mapping[str, Mapping[str, str]]) -> tuple[Mapping[str, object], ...]:
    """Return the rows of a table with one column for each of ``columns``.

    The column ``name`` has every key that is in one of them.
    """
    keys = dict.fromkeys(key for column in columns.values() for key in column)
    return tuple({name: key, **{title: column.get(key) for title, column in columns.items()}} for key in keys)
