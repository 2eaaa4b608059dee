"""Owns the files that belong to the operating system: units, users, rules, limits; which there are, and that they fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kingfisher_setup import durable
from kingfisher_setup.identities import named_or_shipped, with_identities
from kingfisher_setup.layout import PROGRAM, Layout

UNITS = Path("/etc/systemd/system")
RULES = "70-kingfisher.rules"
TRANSFER = "kingfisher-transfer.path"
ENABLED = ("kingfisher.service", TRANSFER)


@dataclass(frozen=True, slots=True)
class Placed:
    """One file of a version's ``systemd`` folder and where the instrument wants it."""

    source: str
    target: Path
    only_beside: Path | None = None
    """A folder without which the file is of no use."""


FILES = (
    Placed("kingfisher.service", UNITS / "kingfisher.service"),
    Placed("kingfisher-safe.service", UNITS / "kingfisher-safe.service"),
    Placed("kingfisher-trial.service", UNITS / "kingfisher-trial.service"),
    Placed("kingfisher-transfer.path", UNITS / "kingfisher-transfer.path"),
    Placed("kingfisher-transfer.service", UNITS / "kingfisher-transfer.service"),
    Placed("kingfisher-keys@.service", UNITS / "kingfisher-keys@.service"),
    Placed("data-disk.conf", UNITS / "var-lib-kingfisher.mount.d" / "kingfisher.conf"),
    Placed("kingfisher.sysusers", Path("/etc/sysusers.d/kingfisher.conf")),
    Placed("kingfisher.tmpfiles", Path("/etc/tmpfiles.d/kingfisher.conf")),
    Placed("kingfisher.modules", Path("/etc/modules-load.d/kingfisher.conf")),
    Placed("kingfisher.journald", Path("/etc/systemd/journald.conf.d/kingfisher.conf")),
    Placed(RULES, Path("/etc/udev/rules.d") / RULES),
    Placed("kingfisher.grub", Path("/etc/default/grub.d/kingfisher.cfg"), Path("/etc/default/grub.d")),
)

LINKS = {
    **{UNITS / "multi-user.target.wants" / unit: str(UNITS / unit) for unit in ENABLED},
    Path("/usr/local/bin/kingfisher"): str(PROGRAM / "current" / "bin" / "kingfisher"),
    Path("/usr/local/sbin/kingfisher-setup"): str(PROGRAM / "rescue" / "install"),
    Path("/usr/local/sbin/kingfisher-transfer"): str(PROGRAM / "current" / "systemd" / "transfer"),
}


def place(layout: Layout, version: str) -> bool:
    """Make them those of ``version``, one after the other, each at once; whether any was another before.

    Called again after an interruption it goes on. What a version does not have is taken away.
    """
    before = _state(layout)
    folder = layout.version(version) / "systemd"
    for file in FILES:
        source, target = folder / file.source, layout.at(file.target)
        if not source.exists() or (file.only_beside is not None and not layout.at(file.only_beside).is_dir()):
            durable.remove(target)
        else:
            durable.write(target, _content(layout, source))
    for link, to in LINKS.items():
        if link.parent.name.endswith(".wants") and not layout.at(to).exists():
            durable.remove(layout.at(link))
        else:
            durable.point(layout.at(link), to)
    return _state(layout) != before


def place_rules(layout: Layout, version: str) -> bool:
    """Make the device rules of ``version`` anew from the rig file; whether that changed them."""
    target = layout.at(next(file.target for file in FILES if file.source == RULES))
    before = target.read_bytes() if target.is_file() else None
    content = _content(layout, layout.version(version) / "systemd" / RULES)
    durable.write(target, content)
    return content != before


def take_away(layout: Layout) -> None:
    """All of them."""
    for target in (*LINKS, *(file.target for file in FILES)):
        durable.remove(layout.at(target))


def _content(layout: Layout, source: Path) -> bytes:
    """What is placed of a file: the file, but for the device rules, which name what the rig file names."""
    content = source.read_bytes()
    if source.name != RULES:
        return content
    return with_identities(content.decode("utf-8"), named_or_shipped(layout.rig)).encode("utf-8")


def _state(layout: Layout) -> dict[Path, bytes | None]:
    targets = [layout.at(file.target) for file in FILES]
    return {target: target.read_bytes() if target.is_file() else None for target in targets}
