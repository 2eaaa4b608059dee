"""The verb ``sim``: the instrument in a simulated world, held by a person, a script, or an unlucky diver."""

from __future__ import annotations

import json
import sys
import tempfile
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from appliance.cli.arguments import one_of, operands, path_option, suggestion, switch, whole_number
from appliance.cli.instrument import serve
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError
from appliance.cli.places import WithRoot
from appliance.cli.simrig import (
    OBJECTS,
    PACES,
    TEXTURES,
    TRUTHS,
    WORLDS,
    SimOptions,
    apply_options,
    check_simulated_wires,
    default_sim_rig,
    simulator_kernels,
)
from appliance.store import Library, UnknownScan

if TYPE_CHECKING:  # loads pydantic, which `--help` does not need
    from appliance.store import Rig

SEED = whole_number(0, 999_999_999)
FAULT = "fault"
SETTINGS: Mapping[str, Callable[[str], Any]] = {
    "object": one_of(OBJECTS),
    "texture": one_of(TEXTURES),
    "truth": str,
    "world": one_of(WORLDS),
    "seed": SEED,
    "size": str,
    "pace": one_of(PACES),
    FAULT: str,
    "chaos": SEED,
    "scans": whole_number(1, 100_000),
}
"""Settings of the world with the parser of each value; only ``fault`` may be repeated."""


def _setting(word: str) -> tuple[str, Any]:
    """Read ``NAME=VALUE``. Raises ArgumentTypeError."""
    name, equals, text = word.partition("=")
    if not equals or name not in SETTINGS:
        near = suggestion(name, SETTINGS) or f"; there are: {', '.join(SETTINGS)}"
        raise ArgumentTypeError(f"{word}: is no SETTING=VALUE{near}")
    try:
        return name, SETTINGS[name](text)
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"{name}={error}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Sim(WithRoot):
    """Run the instrument in a simulated world. Errors of that world have their own exit code."""

    codes: ClassVar[Sequence[Exit]] = (Exit.SCRIPT_FAILED,)
    service: ClassVar[bool] = True
    named_words: ClassVar[Sequence[str]] = tuple(SETTINGS)

    settings: Sequence[tuple[str, Any]] = operands(
        "SETTING=VALUE",
        f"object: {', '.join(OBJECTS)}; texture: {', '.join(TEXTURES)}; truth, the true rig: {', '.join(TRUTHS)}, or "
        f"a truth.toml; "
        f"world: {', '.join(WORLDS)} (a harsher one, drawn by seed); seed of the truth and all noise; size of the "
        f"cameras, for example 800x600; "
        f"pace of world time: {', '.join(PACES)}; fault=SENTENCE, which may be repeated; chaos=SEED: a dive on which "
        f"devices come and go, "
        "with scans=N (200): how often SCAN is pressed",
        at_least_one=False,
        parse=_setting,
    )
    script: Path | None = path_option("--script", "a scenario; exit code 3 if it fails")
    console: bool = switch("--console", "read commands from standard input; --window on a terminal does so, too")
    window: bool = switch("--window", "show both screens in windows; the keyboard is the keypad")

    def run(self) -> Exit:
        settings, faults = self._given()
        chaos_seed, scans = settings.pop("chaos", None), settings.pop("scans", 200)
        if "object" in settings:
            settings["object_name"] = settings.pop("object")
        from appliance.store import load_rig

        rig = load_rig(self.rig or default_sim_rig())
        options = SimOptions(
            root=self.new_root(),
            **settings,
            script=self.script,
            faults=faults,
            window=self.window,
            # Without a terminal, standard input may be closed or belong to another program.
            console=self.console or (self.window and sys.stdin.isatty()),
        )
        if chaos_seed is None:
            return dive(rig, options)
        return chaos(rig, options, chaos_seed, scans, self.tell)

    def _given(self) -> tuple[dict[str, Any], Sequence[str]]:
        """Return the values of the settings except the faults, and the faults.

        Raises UsageError for a setting that is repeated.
        """
        settings: dict[str, Any] = {}
        for name, value in self.settings:
            if name in settings:
                raise UsageError(f"{name}={value}: {name} was given before; give one value")
            if name != FAULT:
                settings[name] = value
        return settings, [value for name, value in self.settings if name == FAULT]


def dive(rig: Rig, options: SimOptions) -> Exit:
    """Run the instrument of ``rig`` in its simulated world until it ends.

    Raises UsageError for options that do not fit.
    """
    simulated_rig = apply_options(check_simulated_wires(rig), options)
    compile_kernels(simulator_kernels)
    from appliance.cli.simtruth import bring_calibration

    bring_calibration(simulated_rig)
    return serve(simulated_rig)


# ------------------------------------------------------------------------------------------ an unlucky dive

CHAOS = "chaos"
"""Name of the option of the simulated world (docs/protocols/world.md)."""


def chaos(rig: Rig, options: SimOptions, seed: int, scans: int, tell: Callable[[Any, Iterable[str]], None]) -> Exit:
    """Dive while devices come and go; FAILED if an accepted scan is lost or damaged or a refusal had no reason.

    ``seed`` is that of everything that happens; SCAN is pressed ``scans`` times.
    """
    if options.script is not None or options.window:
        raise UsageError("chaos: its diver holds the instrument; leave --script and --window out")
    root = options.root or rig.storage.root
    # Earlier scans would be counted as saved by this dive and hide its losses.
    if (root / "scans").exists():
        raise UsageError(f"--root {root}: holds scans already; chaos counts what it left, so give a new folder")
    with tempfile.TemporaryDirectory(prefix="kingfisher-chaos-") as folder:
        report = Path(folder) / "report.json"
        # The world writes what the screen reported into its own file: the disk is judged by that, not by the
        # instrument's own record.
        chosen = {CHAOS: {"seed": seed, "scans": scans, "report": str(report)}, "stills": True}
        # Passed on unread, like all options of a simulated world, of which the product knows only the name.
        world = replace(rig.rig, wires_options={**rig.rig.wires_options, **chosen})
        ended = dive(replace(rig, rig=world), options)
        outcome: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    result = outcome | _verify_accepted(apply_options(replace(rig, rig=world), options), outcome["accepted"])
    tell(result, (f"{key:<12} {_short(value)}" for key, value in result.items()))
    is_sound = not (result["lost"] or result["damaged"] or result["unexplained"])
    # The exit code of the service comes first, because after a crash the other findings are its consequence.
    return ended if ended is not Exit.OK else Exit.OK if is_sound else Exit.FAILED


def _verify_accepted(rig: Rig, accepted: list[str]) -> dict[str, Any]:
    """Verify the scans that the screen reported as saved; return lost and damaged ones, and the count of all."""
    library = Library(rig.storage.root)
    lost, damaged = [], []
    with ProgressLine() as progress:
        for k, scan_id in enumerate(accepted):
            progress(f"verifying {scan_id}", k / len(accepted))
            try:
                if not library.verify(scan_id).ok:
                    damaged.append(scan_id)
            except UnknownScan:
                lost.append(scan_id)
    return {"lost": lost, "damaged": damaged, "saved": library.count()}


def _short(value: object) -> str:
    match value:
        case dict():
            return ", ".join(f"{key} {number}" for key, number in sorted(value.items())) or "-"
        case list():
            return f"{len(value)}" + (f": {value[0]}" if value and isinstance(value[0], str) and len(value) < 3 else "")
        case _:
            return str(value)
