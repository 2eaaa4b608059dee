"""The registers of a maker's features, at the addresses that the description names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hw_sim.devices.feature_book import FeatureBook
from hw_sim.devices.feature_xml import TOP, addresses
from hw_sim.devices.features import CommandFeature, FloatFeature, IntegerFeature, ReadOnlyInteger, Settable
from hw_sim.devices.gencp_memory import Memory

COMMANDS = ("AcquisitionStart", "AcquisitionStop", "TriggerSoftware", "UserSetLoad")


class FeatureTarget(Protocol):
    """The part of a camera that its features act on."""

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def software_trigger(self) -> None: ...

    def features_changed(self, name: str) -> None: ...


def lay_out(memory: Memory, book: FeatureBook, camera: FeatureTarget, base: int) -> None:
    """Add the registers of all features from ``base`` on."""

    def load() -> None:
        book.load_selected()
        camera.features_changed("UserSetLoad")

    commands: dict[str, Callable[[], None]] = dict(
        zip(COMMANDS, (camera.start, camera.stop, camera.software_trigger, load), strict=True)
    )
    where = addresses(book.maker, base)
    for feature in book.maker.features:
        match feature:
            case CommandFeature():
                memory.u32(where[feature.name], None, _pressing(commands[feature.name]))
            case ReadOnlyInteger():
                memory.u32(where[feature.name], _showing(book, feature))
            case _:
                _settable(memory, book, camera, feature, where[feature.name])


def _pressing(action: Callable[[], None]) -> Callable[[int], None]:
    def write(value: int) -> None:
        if value & 1:
            action()

    return write


def _showing(book: FeatureBook, feature: ReadOnlyInteger) -> Callable[[], int]:
    return lambda: book.shown(feature)


def _settable(memory: Memory, book: FeatureBook, camera: FeatureTarget, feature: Settable, address: int) -> None:
    name = feature.name

    def write(value: float) -> None:
        book.write(name, value)
        camera.features_changed(name)

    if isinstance(feature, FloatFeature):
        memory.f64(address, lambda: book.read(name), write)
        return
    memory.u32(address, lambda: int(book.read(name)), write)
    if isinstance(feature, IntegerFeature) and feature.computed:
        memory.u32(address + TOP, lambda: book.high(name))
