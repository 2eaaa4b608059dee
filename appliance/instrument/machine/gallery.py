"""Owns the way through the scans on the disk: the newest first, one at a time; nothing can be changed or deleted."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import effects as do
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Gallery, Machine, State
from drivers.api import Key


def open_gallery(machine: Machine) -> Result:
    """Open the gallery from AIM, or from the menu, which is where BACK leads then."""
    return replace(enter(machine, State.GALLERY), gallery=Gallery()), (do.Wish.LIST_GALLERY,)


def listed(machine: Machine, scans: tuple[str, ...]) -> Result:
    """Show the scans that the disk has; the one that was looked at stays where it is still there."""
    at = machine.gallery
    if machine.state is not State.GALLERY or at is None:
        return machine, ()
    # By its number, not by its place: the newest come first, so that one more scan moves all others.
    index = scans.index(at.scan_id) if at.scan_id is not None and at.scan_id in scans else 0
    return _show(machine, Gallery(scans, index))


def pressed(machine: Machine, key: Key) -> Result:
    """Show a newer scan with UP, an older one with DOWN."""
    at = machine.gallery
    if at is None or key is Key.BACK:
        # `enter` takes a menu along into GALLERY only where it was opened from there.
        return enter(machine, State.AIM if machine.menu is None else State.MENU), ()
    by = {Key.UP: -1, Key.DOWN: 1}.get(key, 0)
    index = at.index + by
    if by == 0 or not 0 <= index < len(at.scans or ()):
        return machine, ()
    return _show(machine, replace(at, index=index))


def may_move(machine: Machine, key: Key) -> bool:
    """Tell whether there is a scan in that direction."""
    at = machine.gallery
    if at is None or not at.scans:
        return False
    return at.index > 0 if key is Key.UP else at.index < len(at.scans) - 1


def _show(machine: Machine, at: Gallery) -> Result:
    effects: tuple[do.Effect, ...] = () if at.scan_id is None else (do.ShowGalleryScan(at.scan_id),)
    return replace(machine, gallery=at), effects
