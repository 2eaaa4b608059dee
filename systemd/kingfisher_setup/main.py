"""Owns what the setup can be asked for, and in which order each answer is made."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from kingfisher_setup import build, identities, placed, target, trial, versions
from kingfisher_setup.durable import remove_tree
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from kingfisher_setup.writable import writable

TREE = Path(__file__).resolve().parents[2]
"""The source tree that this setup is part of; on an instrument, a version's folder, from which nothing can be built."""
TEXT = """Put Kingfisher on an instrument (Debian 12 or later), take a new version on trial, go back.

install    the version of this source tree; where one is in use, like upgrade
upgrade    the same on trial: it stays if it passes its self-test, else the version in use now comes back by itself
rollback   the version before the one in use
rules      the device rules anew, after the USB identity of board or key pad was changed in the rig file
status     what is installed, in use and on trial
uninstall  everything but scans, calibrations and the rig file; --purge takes them as well
"""
ROOT_FREE_MB = 1500
TRANSFER_USER = "kingfisher-pull"
"""As ``kingfisher.sysusers`` and ``kingfisher-sshd.conf`` call it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Do it; returns the exit code. Errors are one message on stderr."""
    arguments = _grammar().parse_args(argv)
    layout = Layout(arguments.root.resolve())
    os.umask(0o022)  # the service is another user
    try:
        if not layout.root.is_dir():
            raise SetupError(f"--root {layout.root}: no such folder; mount the image there first")
        if os.geteuid() != 0 and arguments.verb != "status":
            raise SetupError("this changes the system: run it as root")
        if arguments.verb == "status":
            status(layout)
            return 0
        with writable(layout.changed):
            return _change(layout, arguments)
    except SetupError as error:
        print(f"kingfisher-setup: {error}", file=sys.stderr)
        return 1


def _change(layout: Layout, arguments: argparse.Namespace) -> int:
    match arguments.verb:
        case "watch":
            return trial.watch(layout)
        case "rollback":
            rollback(layout)
        case "rules":
            rules(layout)
        case "uninstall":
            uninstall(layout, purge=arguments.purge)
        case _:
            install(layout, arguments.wheels)
    return 0


def install(layout: Layout, wheels: Path | None) -> None:
    """Build this tree's version and use it; on trial where another is in use."""
    _packages(layout)
    _room(layout)
    with versions.locked(layout):
        _no_trial(layout)
        before = versions.current(layout)
        name = build.build(layout, TREE, wheels, _say)
        if before is None or before == name:
            versions.switch(layout, name)
            versions.trust(layout, name)
        else:
            versions.try_out(layout, name, trial.failed_now(layout, before))
        _system(layout)
    if before is None or before == name:
        target.systemctl(layout, "restart", "--no-block", "kingfisher.service")
        _say(f"{name} is installed" + ("" if layout.live else "; it starts when the image does"))
        if layout.live and not target.runs_systemd(layout):
            _say("systemd does not run here: nothing was started")
    elif target.runs_systemd(layout):
        _say(f"{name} is on trial")
        target.systemctl(layout, "restart", "--no-block", "kingfisher-trial.service", "kingfisher.service")
        _await_outcome(layout, name)
    else:
        _say(f"{name} is on trial from the next start on; {before} comes back if it fails")


def rollback(layout: Layout) -> None:
    """Use the version before. What is on trial is given up."""
    with versions.locked(layout):
        on_trial = versions.settle(layout)
        if on_trial is not None:
            versions.revert(layout, on_trial, "taken back by hand")
            name = on_trial.previous
        else:
            before = versions.previous(layout)
            if before is None:
                raise SetupError("there is no version before this one; `kingfisher-setup status` lists what there is")
            name = before
            versions.switch(layout, name)
            versions.trust(layout, name)
        _system(layout)
    target.systemctl(layout, "restart", "--no-block", "kingfisher.service")
    _say(f"{name} is in use again")


def rules(layout: Layout) -> None:
    """Make the device rules from the rig file and let udev take them. Raises SetupError where the file names no identities."""
    with versions.locked(layout):
        now = versions.current(layout)
        if now is None:
            raise SetupError("nothing is installed; `systemd/install install` makes the rules with everything else")
        found = identities.named(layout.rig)
        changed = placed.place_rules(layout, now)
        _devices(layout)
    said = ", ".join(f"{table} {vendor:04x}:{product:04x}" for table, (vendor, product) in found.items())
    _say(f"{said}: the rules " + ("name them now" if changed else "named them already"))


def uninstall(layout: Layout, *, purge: bool) -> None:
    """Take the program away. Data stay unless ``purge``."""
    with versions.locked(layout):
        if target.runs_systemd(layout):
            units = [
                file.source
                for file in placed.FILES
                if Path(file.source).suffix in (".service", ".path") and "@" not in file.source
            ]
            loaded = [unit for unit in units if layout.at(placed.UNITS / unit).exists()]
            if loaded:
                target.systemctl(layout, "disable", "--now", *loaded)
        placed.take_away(layout)
        remove_tree(layout.program)
        _system(layout)
        if purge:
            remove_tree(layout.data)
            remove_tree(layout.rig.parent)
            remove_tree(layout.at("/var/cache/kingfisher"))
    _say("uninstalled" if purge else f"uninstalled; {layout.data} and {layout.rig} are still there")


def status(layout: Layout) -> None:
    """Print what there is."""
    now, before, at = versions.current(layout), versions.previous(layout), versions.trial(layout)
    for name in versions.installed(layout):
        marks = [word for word, is_it in (("in use", name == now), ("before", name == before)) if is_it]
        marks += ["on trial"] if at is not None and at.version == name else []
        print(f"{name:<24} {', '.join(marks)}".rstrip())
    ended = versions.outcome(layout)
    if ended is not None:
        print(f"last trial: {ended.version} {'was accepted' if ended.accepted else 'was taken back'}: {ended.reason}")
    if now is None:
        print("nothing is installed")


def _packages(layout: Layout) -> None:
    missing = target.missing_packages(layout)
    if not missing:
        return
    if not layout.live:
        raise SetupError(f"{layout.root} lacks these Debian packages, install them there first: {' '.join(missing)}")
    _say(f"Debian packages: {' '.join(missing)}")
    target.install_packages(missing)


def _room(layout: Layout) -> None:
    free_mb = shutil.disk_usage(layout.root).free // 1_000_000
    if free_mb < ROOT_FREE_MB:
        raise SetupError(f"{layout.root} has {free_mb} MB free; a version needs {ROOT_FREE_MB} MB: remove something")


def _no_trial(layout: Layout) -> None:
    at = versions.settle(layout)
    if at is not None:
        raise SetupError(f"{at.version} is on trial; wait until that has ended, or take it back with `rollback`")
    versions.prune(layout)


def _system(layout: Layout) -> None:
    """Let the operating system take notice of what was placed or taken away."""
    if layout.at("/etc/sysusers.d/kingfisher.conf").exists():
        target.run(layout, ["systemd-sysusers"])
        _no_password(layout)
    if not target.runs_systemd(layout):
        return
    target.systemctl(layout, "daemon-reload")
    target.run(layout, ["systemd-tmpfiles", "--create"])
    if layout.at(placed.UNITS / placed.TRANSFER).exists():
        target.systemctl(layout, "restart", placed.TRANSFER)
    _devices(layout)
    target.systemctl(layout, "try-restart", "systemd-journald.service")
    if layout.at("/boot/grub/grub.cfg").exists() and shutil.which("update-grub") is not None:
        target.run(layout, ["update-grub"])


def _devices(layout: Layout) -> None:
    """Let udev read its rules again and apply them to what is plugged in."""
    if not layout.live:
        return
    if target.UDEV.exists():
        target.run(layout, ["udevadm", "control", "--reload"])
        target.run(layout, ["udevadm", "trigger"])
    else:
        _say("udev does not run: its rules count from the next start")


def _no_password(layout: Layout) -> None:
    """Give the user of the transfer a password that nothing fits: sshd lets a locked account in with no key either."""
    shadow = layout.at("/etc/shadow")
    if shadow.exists() and f"\n{TRANSFER_USER}:!" in shadow.read_text(encoding="utf-8"):
        target.run(layout, ["usermod", "--password", "*", TRANSFER_USER])


def _await_outcome(layout: Layout, name: str) -> None:
    """Say how the trial ended. Raises SetupError when the version was taken back."""
    end_s = time.monotonic() + trial.LIMIT_S * versions.STARTS
    while time.monotonic() < end_s:
        how = versions.outcome(layout)
        if how is not None and how.version == name:
            if not how.accepted:
                raise SetupError(f"{name} was taken back: {how.reason}; {how.now} is in use again")
            _say(f"{name} has passed its self-test and stays")
            return
        time.sleep(0.5)
    raise SetupError(f"{name}: the trial has not ended; see `journalctl -u kingfisher-trial`")


def _say(text: str) -> None:
    print(f"kingfisher-setup: {text}", flush=True)


def _grammar() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kingfisher-setup", description=TEXT, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "verb", choices=("install", "upgrade", "rollback", "rules", "status", "uninstall", "watch"), metavar="VERB"
    )
    parser.add_argument("--root", type=Path, default=Path("/"), metavar="DIR", help="a mounted image (default: /)")
    parser.add_argument("--wheels", type=Path, metavar="DIR", help="the packages as wheels (default: from PyPI)")
    parser.add_argument("--purge", action="store_true", help="of uninstall: scans, calibrations, rig file as well")
    return parser
