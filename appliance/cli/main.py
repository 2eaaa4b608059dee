"""Owns the command line's grammar and its exit codes; everything that can be typed is declared here."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from appliance import __version__
from appliance.calibration.file import CalibrationError
from appliance.calibration.method import BY_SCANS
from appliance.calibration.recordings import RecordingError
from appliance.cli import calibrate, calibrate_air, evaluate, health, measure, scans, shelves, verbs
from appliance.cli.chaos import Chaos, chaos
from appliance.cli.last_words import last_words
from appliance.cli.output import Exit, UsageError, complain, log_lines
from appliance.cli.simrig import OBJECTS, PACES, TEXTURES, TRUTHS, SimOptions, default_sim_rig
from appliance.config import ConfigError, Rig, default_rig_path, load_rig
from appliance.kernel_build import CompileError
from appliance.service.origin import Wish
from appliance.storage.atomic import StorageError
from appliance.storage.label import LONGEST_NAME, LONGEST_NOTE
from appliance.storage.library import UnknownScan
from appliance.storage.scan import ScanError
from drivers.api import DeviceError

_NEGATIVE = re.compile(r"-\.?\d.*")
"""A value that begins with a minus, and no option: none of ours begins with a digit."""


def _exit_codes(*of: Exit) -> str:
    """The end of a help text: the codes that every verb may end with, and those ``of`` this one."""
    usual = (Exit.OK, Exit.FAILED, Exit.USAGE, *of, Exit.INTERRUPTED)
    return "exit codes: " + ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in usual)


Verb = Callable[[argparse.Namespace], Exit]


class _Parser(argparse.ArgumentParser):
    """Errors in one line, no abbreviations; ``--json`` is honoured even where the rest does not parse."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)
        # argparse takes "-5x3x1x1" for an option and says "expected one argument": let the value be judged instead.
        self._negative_number_matcher = _NEGATIVE

    def error(self, message: str) -> NoReturn:
        complain(f"{message}; see `{self.prog} --help`", as_json="--json" in sys.argv[1:])
        raise SystemExit(Exit.USAGE)


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, call the verb's function, return the exit code. Errors end as one line on stderr."""
    arguments = _grammar().parse_args(argv)
    verb: Verb = arguments.verb
    try:
        with (
            log_lines(as_json=arguments.json, service=arguments.service or getattr(arguments, "live", False)),
            last_words(os.environ if arguments.service else {}),
        ):
            return verb(arguments)
    except (ConfigError, UsageError) as error:
        complain(str(error), as_json=arguments.json)
        return Exit.USAGE
    except (StorageError, UnknownScan, ScanError, CalibrationError, RecordingError, DeviceError, CompileError) as error:
        complain(str(error), as_json=arguments.json)
        return Exit.FAILED
    except BrokenPipeError:
        sys.stderr.close()  # the reader of stdout went away: not our failure, and nobody to tell
        return Exit.OK
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except Exception as error:
        code = getattr(error, "exit_code", None)  # of a simulated world, whose errors nothing here knows by name
        if code is None:
            raise
        complain(str(error), as_json=arguments.json)
        return Exit(code)


def _rig(arguments: argparse.Namespace) -> Rig:
    return load_rig(arguments.rig or default_rig_path())


def _root(arguments: argparse.Namespace) -> Path:
    """Where only stored scans are read, no rig file is needed, and none is read."""
    return _rig(arguments).storage.root if arguments.root is None else _given_root(arguments.root)


def _rooted(arguments: argparse.Namespace) -> Rig:
    rig = _rig(arguments)
    if arguments.root is None:
        return rig
    return replace(rig, storage=replace(rig.storage, root=_given_root(arguments.root)))


def _wish(arguments: argparse.Namespace) -> Wish:
    """What was asked for beside a scan; a rig file is only read where one was given."""
    return Wish(
        rig=None if arguments.rig is None else load_rig(arguments.rig),
        root=None if arguments.root is None else _given_root(arguments.root),
        calibration=getattr(arguments, "calibration", None),
        current=getattr(arguments, "current", False),
        foreign=getattr(arguments, "foreign_calibration", False),
    )


def _add_choice_of_calibration(verb: _Parser) -> None:
    """For verbs that make points: by default each scan's own calibration."""
    which = verb.add_mutually_exclusive_group()
    which.add_argument("--calibration", type=Path, metavar="FILE", help="default: the one the scan was taken with")
    which.add_argument("--current", action="store_true", help="the one in use under the storage root")
    verb.add_argument("--foreign-calibration", action="store_true", help="also if it is another instrument's")


def _given_root(root: Path) -> Path:
    if root.is_file():
        raise UsageError(f"--root {root}: is a file; give the folder that holds scans/")
    if not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; give the storage root that holds scans/")
    return root


def _run(arguments: argparse.Namespace) -> Exit:
    """With a root of its own where one is given; it is made if it is not there."""
    rig, root = _rig(arguments), arguments.root
    if root is not None:
        rig = replace(rig, storage=replace(rig.storage, root=_new_root(root)))
    return verbs.run(rig)


def _new_root(root: Path) -> Path:
    if root.exists() and not root.is_dir():
        raise UsageError(f"--root {root}: is a file; give a folder, which is made if it is not there")
    return root.absolute()


def _sim(arguments: argparse.Namespace) -> Exit:
    rig = load_rig(arguments.rig or default_sim_rig())
    options = SimOptions(
        root=None if arguments.root is None else _new_root(arguments.root),
        object_name=arguments.object,
        texture=arguments.texture,
        truth=arguments.truth,
        seed=arguments.seed,
        size=arguments.size,
        pace=arguments.pace,
        script=arguments.script,
        faults=tuple(arguments.fault),
        window=arguments.window,
        console=arguments.console or (arguments.window and sys.stdin.isatty()),
    )
    if arguments.chaos is None:
        return verbs.sim(rig, options)
    return chaos(rig, options, Chaos(arguments.chaos, arguments.scans), json=arguments.json)


def _grammar() -> _Parser:
    common = _Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="print one JSON document")
    rig = _Parser(add_help=False)
    rig.add_argument("--rig", type=Path, metavar="PATH", help="rig file (default: the packaged one)")
    root = _Parser(add_help=False)
    root.add_argument("--root", type=Path, metavar="PATH", help="storage root (default: the rig file's)")

    top = _Parser(
        prog="kingfisher",
        description="Handheld underwater 3D scanner.",
        epilog=_exit_codes(Exit.SCRIPT_FAILED, Exit.DAMAGED),
    )
    top.add_argument("--version", action="version", version=f"kingfisher {__version__}")
    commands = top.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)

    def add(
        where: argparse._SubParsersAction[_Parser],
        name: str,
        text: str,
        verb: Verb,
        *parents: _Parser,
        codes: Sequence[Exit] = (),
    ) -> _Parser:
        parser = where.add_parser(
            name, help=text, description=text, epilog=_exit_codes(*codes), parents=[common, *parents]
        )
        parser.set_defaults(verb=verb, service=False)
        return parser

    run = add(commands, "run", "run the instrument", _run, rig, root)
    run.set_defaults(service=True)

    sim = add(commands, "sim", "run the instrument in a simulated world", _sim, rig, root, codes=(Exit.SCRIPT_FAILED,))
    sim.set_defaults(service=True)
    sim.add_argument("--object", choices=OBJECTS, help="what lies before the scanner")
    sim.add_argument("--texture", choices=TEXTURES, help="its albedo")
    sim.add_argument("--truth", metavar="SET", help=f"the true rig: {', '.join(TRUTHS)}, or a truth.toml")
    sim.add_argument("--seed", type=_seed, help="seeds the truth and all noise")
    sim.add_argument("--size", metavar="WxH", help="camera size in px, for example 800x600")
    sim.add_argument("--pace", choices=PACES, help="how world time passes")
    sim.add_argument("--script", type=Path, metavar="FILE", help="a diver's script; exit code 3 if it fails")
    sim.add_argument("--fault", action="append", default=[], metavar="SENTENCE", help="a fault; may be repeated")
    sim.add_argument("--chaos", type=_seed, metavar="SEED", help="a dive on which devices come and go, seeded")
    sim.add_argument("--scans", type=_count, default=200, help="of --chaos: how often SCAN is pressed (default 200)")
    sim.add_argument(
        "--console", action="store_true", help="commands on standard input; as --window on a terminal has it"
    )
    sim.add_argument("--window", action="store_true", help="show both screens in windows; the keyboard is the key pad")

    add(commands, "check", "open every device once and report", lambda a: verbs.check(_rig(a), json=a.json), rig)

    reconstruct = add(
        commands,
        "reconstruct",
        "reconstruct a stored scan from its raw frames",
        lambda a: verbs.reconstruct(_wish(a), a.scan, a.out, damaged=a.salvage, json=a.json),
        rig,
        root,
    )
    reconstruct.add_argument("scan", metavar="SCAN", help="its number or its folder")
    _add_choice_of_calibration(reconstruct)
    reconstruct.add_argument("--salvage", action="store_true", help="do without a damaged frame; the cloud says so")
    reconstruct.add_argument("--out", type=Path, metavar="FILE", help="write the cloud there (PLY)")

    evaluation = add(
        commands,
        "evaluate",
        "measure artefacts in stored scans, after VDI/VDE 2634",
        lambda a: evaluate.evaluate(_wish(a), a.list, a.out, json=a.json),
        rig,
        root,
    )
    evaluation.add_argument("list", metavar="LIST", type=Path, help="which artefact each scan shows (TOML or JSON)")
    _add_choice_of_calibration(evaluation)
    evaluation.add_argument("--out", type=Path, metavar="FILE", help="the page, and beside it FILE with .json")

    _add_scans(add, commands, rig, root)
    _add_calibration(add, commands, rig, root)
    _add_measure(add, commands, rig, root)
    _add_health(add, commands, rig, root)
    _add_calibrate(add, commands, rig, root)
    warm = add(
        commands,
        "warm",
        "compile the kernels for this processor (an installation does)",
        lambda a: verbs.warm(a.out, common=a.common, json=a.json),
    )
    warm.add_argument("--out", type=Path, metavar="DIR", help="default: within the installed environment")
    warm.add_argument(
        "--common", action="store_true", help="for every x86-64-v3 processor instead of this one: for images"
    )
    add(commands, "version", "print the version", lambda a: verbs.version(json=a.json))
    return top


_Add = Callable[..., _Parser]


def _add_scans(
    add: _Add,
    commands: argparse._SubParsersAction[_Parser],
    rig: _Parser,
    root: _Parser,
) -> None:
    group = commands.add_parser("scans", help="look at stored scans", epilog=_exit_codes())
    inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    every = "also those rejected, set aside or in the trash"

    listing = add(
        inner,
        "list",
        "all scans",
        lambda a: scans.list_scans(_root(a), every=a.all, trash=a.trash, json=a.json),
        rig,
        root,
    )
    which = listing.add_mutually_exclusive_group()
    which.add_argument("--all", action="store_true", help=every)
    which.add_argument("--trash", action="store_true", help="only those in the trash")
    show = add(
        inner,
        "show",
        "one scan's manifest",
        lambda a: scans.show_scan(partial(_root, a), a.scan, json=a.json),
        rig,
        root,
    )
    show.add_argument("scan", metavar="SCAN", help="its number or its folder")
    verify = add(
        inner,
        "verify",
        "compare every byte with its checksum",
        lambda a: scans.verify_scans(partial(_root, a), a.scans, every=a.all, json=a.json),
        rig,
        root,
        codes=(Exit.DAMAGED,),
    )
    verify.add_argument("scans", metavar="SCAN", nargs="*", help="numbers or folders (default: all)")
    verify.add_argument("--all", action="store_true", help=every)
    for verb, text, shelve, what in (
        ("name", "call a scan something", shelves.name_scan, f"up to {LONGEST_NAME} characters; empty: none"),
        ("note", "write a note about a scan", shelves.note_scan, f"up to {LONGEST_NOTE} characters; empty: none"),
    ):
        said = add(inner, verb, text, _labels(shelve), rig, root)
        said.add_argument("scan", metavar="SCAN", help="its number")
        said.add_argument("text", metavar=verb.upper(), help=what)
    for verb, text, move in (
        ("trash", "put scans away; nothing is deleted, and numbers stay taken", shelves.trash),
        ("restore", "take scans out of the trash", shelves.restore),
    ):
        moved = add(inner, verb, text, _moves(move), rig, root)
        moved.add_argument("scans", metavar="SCAN", nargs="+", help="numbers")
    merge = add(
        inner,
        "merge",
        "one cloud of two scans that were taken with different exposures from the same place",
        lambda a: verbs.merge(_wish(a), (a.first, a.second), a.out, json=a.json),
        rig,
        root,
    )
    merge.add_argument("first", metavar="SCAN", help="its number or its folder")
    merge.add_argument("second", metavar="SCAN", help="the other one; their order does not matter")
    _add_choice_of_calibration(merge)
    merge.add_argument("--out", type=Path, metavar="FILE", help="default: NUMBER+NUMBER.ply here")


def _labels(verb: Callable[..., Exit]) -> Verb:
    return lambda a: verb(_root(a), a.scan, a.text, json=a.json)


def _moves(verb: Callable[..., Exit]) -> Verb:
    return lambda a: verb(_root(a), a.scans, json=a.json)


def _add_calibration(
    add: _Add,
    commands: argparse._SubParsersAction[_Parser],
    rig: _Parser,
    root: _Parser,
) -> None:
    group = commands.add_parser("calibration", help="look at calibrations", epilog=_exit_codes())
    inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    show = add(
        inner,
        "show",
        "the calibration in use, or that of a file",
        lambda a: verbs.calibration_show(_rooted(a), a.file, json=a.json),
        rig,
        root,
    )
    show.add_argument("file", metavar="FILE", nargs="?", type=Path)
    nominal = add(
        inner,
        "nominal",
        "write the calibration that follows from the rig file's design",
        lambda a: verbs.calibration_nominal(_rooted(a), a.out, json=a.json),
        rig,
        root,
    )
    nominal.add_argument("--out", type=Path, metavar="FILE", help="default: beside the instrument's calibrations")


def _add_measure(
    add: _Add,
    commands: argparse._SubParsersAction[_Parser],
    rig: _Parser,
    root: _Parser,
) -> None:
    group = commands.add_parser("measure", help="measure the instrument itself in a stored scan", epilog=_exit_codes())
    inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    response = add(
        inner,
        "response",
        "the projector's light by code, from a scan of a plane",
        lambda a: measure.response(_wish(a), a.scan, a.out, json=a.json),
        rig,
        root,
    )
    response.add_argument("scan", metavar="SCAN", help="its number or its folder")
    response.add_argument("--out", type=Path, metavar="FILE", help="default: where the instrument looks for it")
    noise = add(
        inner,
        "noise",
        "both cameras' noise, beside what their data sheets make expect",
        lambda a: measure.noise(_wish(a), a.scan, json=a.json),
        rig,
        root,
    )
    noise.add_argument("scan", metavar="SCAN", help="its number or its folder")


def _add_health(
    add: _Add,
    commands: argparse._SubParsersAction[_Parser],
    rig: _Parser,
    root: _Parser,
) -> None:
    group = commands.add_parser("health", help="whether the calibration still holds", epilog=_exit_codes())
    inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    add(
        inner,
        "show",
        "the trend of the ray gaps",
        lambda a: health.show(_rooted(a), json=a.json),
        rig,
        root,
    )
    accept = add(
        inner,
        "accept",
        "take an alarm back after a length check",
        lambda a: health.accept(_rooted(a), a.report, a.at_most_percent, json=a.json),
        rig,
        root,
    )
    accept.add_argument("report", metavar="REPORT", type=Path, help="the .json that `kingfisher evaluate` wrote")
    accept.add_argument(
        "--at-most-percent",
        type=_percent,
        default=health.AT_MOST_PERCENT,
        metavar="E_L",
        help=f"largest length error that is accepted (default: {health.AT_MOST_PERCENT:g})",
    )


def _percent(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value <= 10.0:
        raise argparse.ArgumentTypeError(f"{text}: allowed are numbers above 0, up to 10")
    return value


def _add_calibrate(
    add: _Add,
    commands: argparse._SubParsersAction[_Parser],
    rig: _Parser,
    root: _Parser,
) -> None:
    group = commands.add_parser("calibrate", help="make calibrations", epilog=_exit_codes())
    inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    air = add(
        inner,
        "air",
        "lenses and stereo pose, from pictures of a board in air",
        lambda a: calibrate_air.air(_rooted(a), a.folder, _air_options(a), json=a.json),
        rig,
        root,
    )
    air.add_argument(
        "folder",
        metavar="FOLDER",
        type=Path,
        help="pairs NAME_left.png, NAME_right.png, or folders of --live or of scans",
    )
    air.add_argument(
        "--board", metavar="15x12x18x13.5", help="squares across and down, their size and the markers' in mm"
    )
    air.add_argument("--out", type=Path, metavar="FILE", help="default: air.json in FOLDER; pictures go beside it")
    air.add_argument("--install", action="store_true", help="make it the start of this instrument's calibrations")
    live = calibrate_air.AirOptions()
    air.add_argument("--live", action="store_true", help="record the views first, with this instrument, into FOLDER")
    air.add_argument("--views", type=_views, default=live.views, metavar="N", help="default: %(default)s")
    air.add_argument("--room-light", action="store_true", help="the projector stays dark")
    air.add_argument("--exposure-ms", type=_positive_ms, metavar="MS", help="default: the rig file's")
    air.add_argument(
        "--patience-s",
        type=_positive_s,
        default=live.patience_s,
        metavar="S",
        help="without a new view, default: %(default)g",
    )
    water = add(
        inner,
        "water",
        "calibrate from scans of ball bars and planes in water",
        lambda a: calibrate.water(_wish(a), a.list, _water_options(a), json=a.json),
        rig,
        root,
    )
    usual = calibrate.WaterOptions()
    water.add_argument("list", metavar="LIST", type=Path, help="which artefact each scan shows, as for evaluate")
    water.add_argument(
        "--method", choices=[m.value for m in BY_SCANS], default=usual.method, help="default: %(default)s"
    )
    water.add_argument("--start", type=Path, metavar="FILE", help="default: the instrument's calibration in air")
    water.add_argument("--out", type=Path, metavar="FILE", help="the calibration; beside it FILE-report.html and .json")
    water.add_argument("--install", action="store_true", help="use it from now on; the one of before is kept")
    water.add_argument(
        "--published-flatness", action="store_true", help="rm, rmd: flatness from the points, noise and all"
    )
    water.add_argument("--reach-mm", type=_positive, metavar="MM", help="rm, rmd: search so far around the drawing")
    water.add_argument(
        "--steps-mm",
        type=_positives,
        metavar="MM,MM",
        help="rm, rmd: step widths, each around the best of the one before",
    )
    back = add(
        inner,
        "restore",
        "use the calibration of before again; a second time undoes it",
        lambda a: calibrate.restore(_rooted(a), a.name, json=a.json),
        rig,
        root,
    )
    back.add_argument("name", metavar="NAME", nargs="?", help="a file of calibration/kept (default: the last one)")


def _air_options(arguments: argparse.Namespace) -> calibrate_air.AirOptions:
    return calibrate_air.AirOptions(
        board=arguments.board,
        out=arguments.out,
        install=arguments.install,
        live=arguments.live,
        views=arguments.views,
        room_light=arguments.room_light,
        exposure_ms=arguments.exposure_ms,
        patience_s=arguments.patience_s,
    )


def _views(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 6 <= int(text[:6]) <= 200:
        raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers 6..200")
    return int(text)


def _positive_ms(text: str) -> float:
    return _between(text, 0.05, 16.0)


def _positive_s(text: str) -> float:
    return _between(text, 1.0, 86400.0)


def _between(text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text}: allowed are {low:g}..{high:g}")
    return value


def _water_options(arguments: argparse.Namespace) -> calibrate.WaterOptions:
    return calibrate.WaterOptions(
        method=arguments.method,
        start=arguments.start,
        out=arguments.out,
        published_flatness=arguments.published_flatness,
        reach_mm=arguments.reach_mm,
        steps_mm=arguments.steps_mm,
        install=arguments.install,
    )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.01 <= value <= 50.0:
        raise argparse.ArgumentTypeError(f"{text}: allowed are numbers 0.01..50 (mm)")
    return value


def _positives(text: str) -> tuple[float, ...]:
    return tuple(_positive(part) for part in text.split(","))


def _seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers 0..999999999")
    return int(text)


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= 100_000:
        raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers 1..100000")
    return int(text)
