"""Opening the outputs: projector and display, on one card or two, on a connector or in a window."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self, assert_never

from drivers.api import CardGone, DeviceError, DeviceGone, DeviceRefused, Display, Projector, Wires
from drivers.output.card import Card, Connector
from drivers.output.choice import assign_crtcs, choose_connector, choose_mode
from drivers.output.display import PictureDisplay
from drivers.output.head import Head, device_errors
from drivers.output.projector import PatternProjector
from drivers.output.spec import OutputKind, OutputSpec
from drivers.output.surface import Surface

PROJECTOR, DISPLAY = "projector", "display"


@contextlib.contextmanager
def open_outputs(
    projector_spec: OutputSpec, display_spec: OutputSpec, wires: Wires
) -> Iterator[tuple[Projector, Display]]:
    """Yield both outputs, lit and black.

    Raises DeviceError when either fails; ``Outputs`` can do with one.
    """
    with Outputs(projector_spec, display_spec, wires) as outputs:
        yield outputs.open_projector(), outputs.open_display()


class Outputs:
    """The two outputs of a rig, each opened, closed and opened again without disturbing the other.

    Two heads of one card share its descriptor, since a card has one master. CRTCs are assigned to both heads together,
    before the first is lit, also while one of them is unplugged.
    """

    def __init__(self, projector_spec: OutputSpec, display_spec: OutputSpec, wires: Wires) -> None:
        self._specs = {PROJECTOR: projector_spec, DISPLAY: display_spec}
        self._wires = wires
        self._cards: dict[str, Card] = {}
        self._surfaces: dict[str, Surface[Any]] = {}
        self._heads: dict[str, Head] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for device in list(self._surfaces):
            self._close(device)
        for path in list(self._cards):
            self._drop_card(path)

    def open_projector(self) -> PatternProjector[Any]:
        """Return the projector, lit and black; an open one is closed first. Raises DeviceError."""
        return PatternProjector(self._surface(PROJECTOR), all_channels=self._specs[PROJECTOR].all_channels)

    def close_projector(self) -> None:
        """Darken the projector's output and keep its card, so that no other program lights it. Idempotent."""
        self._close(PROJECTOR)

    def open_display(self) -> PictureDisplay[Any]:
        """Return the display, lit and black; an open one is closed first. Raises DeviceError."""
        return PictureDisplay(self._surface(DISPLAY))

    def _surface(self, device: str) -> Surface[Any]:
        self._close(device)
        spec = self._specs[device]
        match spec.kind:
            case OutputKind.KMS:
                head = self._head(device, spec)
                self._heads[device] = head
                surface: Surface[Any] = head
            case OutputKind.WINDOW:
                from drivers.output.window import Window  # an instrument never loads the window library

                surface = Window(device, spec, self._wires.clock)
            case _:
                assert_never(spec.kind)
        self._surfaces[device] = surface
        return surface

    def _head(self, device: str, spec: OutputSpec) -> Head:
        if spec.card is None or spec.connector is None:
            raise DeviceRefused(device, "kind kms needs card and connector", f"Set both under [{device}]")
        try:
            return self._light(device, spec, self._card(device, spec.card))
        except CardGone:
            # The card went away and came back since its node was opened: all handles on that are invalid.
            self._drop_card(spec.card)
            return self._light(device, spec, self._card(device, spec.card))

    def _light(self, device: str, spec: OutputSpec, card: Card) -> Head:
        with device_errors(device, f"reading the connectors of {spec.card}"):
            card.scan()
            connectors = card.connectors()
            connector = choose_connector(device, spec, connectors)
            connector = card.connector(connector.id, probe=True)
        mode = choose_mode(device, spec, connector)
        crtc = self._crtc(device, spec, card, connectors)
        return Head(device, card, connector, crtc, mode, self._wires.clock)

    def _crtc(self, device: str, spec: OutputSpec, card: Card, connectors: list[Connector]) -> int:
        possible: dict[str, tuple[int, ...]] = {}
        for other_device, other_spec in self._specs.items():
            if other_spec.kind is not OutputKind.KMS or other_spec.card != spec.card:
                continue
            if other_device in self._heads:
                possible[other_device] = (self._heads[other_device].crtc,)
                continue
            named = next((c for c in connectors if c.name == other_spec.connector), None)
            if named is not None:  # a name that does not exist is reported when that output is opened
                with device_errors(device, f"asking which CRTC can drive {named.name}"):
                    possible[other_device] = card.possible_crtcs(named)
        assigned = assign_crtcs(list(possible.values()))
        if assigned is None:
            counts = "; ".join(f"{other_device}: {len(crtcs)} possible" for other_device, crtcs in possible.items())
            raise DeviceRefused(
                device,
                f"{spec.card} has no CRTC of its own for every output ({counts})",
                "Move one output to another connector or card",
            )
        return dict(zip(possible, assigned, strict=True))[device]

    def _card(self, device: str, path: str) -> Card:
        if path not in self._cards:
            try:
                node = self._wires.open_card(path)
            except DeviceError as error:
                # The node's error has only its path; add which output is dark.
                raise type(error)(device, f"{path} {error.message}", error.remedy) from error
            except OSError as error:
                raise DeviceGone(
                    device, f"{path} cannot be opened ({error.strerror})", "Check the graphics driver"
                ) from error
            self._cards[path] = Card(node, self._wires.clock)
        return self._cards[path]

    def _close(self, device: str) -> None:
        self._heads.pop(device, None)
        surface = self._surfaces.pop(device, None)
        if surface is not None:
            surface.close()

    def _drop_card(self, path: str) -> None:
        for device, spec in self._specs.items():
            if spec.kind is OutputKind.KMS and spec.card == path:
                self._close(device)
        card = self._cards.pop(path, None)
        if card is not None:
            with contextlib.suppress(OSError):
                card.close()
