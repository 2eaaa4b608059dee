"""The gallery of scans on the disk: the newest first, one at a time, read only."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import effects as do
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Gallery, Machine, State
from drivers.api import Key


def open_gallery(machine: Machine) -> Result:
    """Open the gallery from AIM or from the menu; BACK returns there."""
    return replace(enter(machine, State.GALLERY), gallery=Gallery()), (do.Wish.LIST_GALLERY,)


def listed(machine: Machine, scans: tuple[str, ...]) -> Result:
    """Show the scans of the disk; the selected one stays selected if it is still there."""
    gallery = machine.gallery
    if machine.state is not State.GALLERY or gallery is None:
        return machine, ()
    # By its number, not by its index: a new scan comes first and moves all others.
    index = scans.index(gallery.scan_id) if gallery.scan_id is not None and gallery.scan_id in scans else 0
    return _show(machine, Gallery(scans, index))


def pressed(machine: Machine, key: Key) -> Result:
    """Show a newer scan with UP, an older one with DOWN."""
    gallery = machine.gallery
    if gallery is None or key is Key.BACK:
        # `enter` keeps the menu only if the gallery was opened from there.
        return enter(machine, State.AIM if machine.menu is None else State.MENU), ()
    step = {Key.UP: -1, Key.DOWN: 1}.get(key, 0)
    index = gallery.index + step
    if step == 0 or not 0 <= index < len(gallery.scans or ()):
        return machine, ()
    return _show(machine, replace(gallery, index=index))


def may_move(machine: Machine, key: Key) -> bool:
    """Return True if there is a scan in that direction."""
    gallery = machine.gallery
    if gallery is None or not gallery.scans:
        return False
    return gallery.index > 0 if key is Key.UP else gallery.index < len(gallery.scans) - 1


def _show(machine: Machine, gallery: Gallery) -> Result:
    effects: tuple[do.Effect, ...] = () if gallery.scan_id is None else (do.ShowGalleryScan(gallery.scan_id),)
    return replace(machine, gallery=gallery), effects
