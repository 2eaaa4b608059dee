"""The GenICam description of a maker's camera: common nodes from ``u3v_camera.xml``, and its features.

Each register is described as not cachable, since selectors, user sets and automatic functions change its value.
"""

from __future__ import annotations

import uuid
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from importlib import resources

from hw_sim.devices.features import (
    AnyFeature,
    BooleanFeature,
    CommandFeature,
    EnumerationFeature,
    FloatFeature,
    IntegerFeature,
    ReadOnlyInteger,
)
from hw_sim.devices.makers import Maker

NAMESPACE = "http://www.genicam.org/GenApi/Version_1_1"
SCHEMA_NAMESPACE = "http://www.w3.org/2001/XMLSchema-instance"
DEVICE_CATEGORY, ROOT = "DeviceControl", "Root"
SPACING = 16
"""Bytes from one feature's registers to the next one's: a value of up to 8, and an upper limit."""
TOP = 8
OWN_FEATURES = {"OverlapMode": "Custom", "ExposureOverlapTimeMax": "Custom", "GammaEnable": "Custom"}
"""Features that are not in the standard."""


def addresses(maker: Maker, base: int) -> Mapping[str, int]:
    """Return the address of each feature's register."""
    return {feature.name: base + SPACING * index for index, feature in enumerate(maker.features)}


def description(maker: Maker, base: int) -> bytes:
    """Return the description, with the features' registers from ``base`` on."""
    ElementTree.register_namespace("", NAMESPACE)
    ElementTree.register_namespace("xsi", SCHEMA_NAMESPACE)
    common = ElementTree.fromstring(resources.files(__package__).joinpath("u3v_camera.xml").read_bytes())
    common.set("ModelName", _identifier(maker.model))
    common.set("VendorName", _identifier(maker.vendor))
    # Hosts cache descriptions by this number: another description needs another number.
    common.set("ProductGuid", str(uuid.uuid5(uuid.NAMESPACE_URL, maker.model)).upper())
    port = _keep_common(common)
    _add_categories(common, maker)
    selected: dict[str, list[str]] = {}
    for feature in maker.features:
        if feature.selector is not None:
            selected.setdefault(feature.selector, []).append(feature.name)
    where = addresses(maker, base)
    for feature in maker.features:
        _Writer(common, where).feature(feature, selected.get(feature.name, []))
    common.append(port)
    ElementTree.indent(common)
    body = ElementTree.tostring(common, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{body}\n'.encode()


def _identifier(text: str) -> str:
    plain = "".join(letter for letter in text if letter.isalnum())
    return plain if plain[0].isalpha() else f"M{plain}"  # the schema wants a letter first


def _tag(name: str) -> str:
    return f"{{{NAMESPACE}}}{name}"


def _keep_common(root: ElementTree.Element) -> ElementTree.Element:
    """Remove all nodes except the device category and its children; remove and return the port."""
    nodes = {node.get("Name"): node for node in root}
    kept_names: set[str | None] = {DEVICE_CATEGORY}
    waiting: list[str | None] = [DEVICE_CATEGORY]
    while waiting:
        node = nodes[waiting.pop()]
        leads_to = {child.text for child in node if child.tag in (_tag("pFeature"), _tag("pValue"))}
        waiting += leads_to - kept_names
        kept_names |= leads_to
    port = nodes["Device"]
    for name, node in nodes.items():
        if name not in kept_names:
            root.remove(node)
    return port


def _add_categories(root: ElementTree.Element, maker: Maker) -> None:
    """Put the maker's features into their categories, and all categories below the root, which comes first."""
    device = next(node for node in root if node.get("Name") == DEVICE_CATEGORY)
    by_name = {DEVICE_CATEGORY: device}
    for feature in maker.features:
        category = by_name.get(feature.category)
        if category is None:
            category = ElementTree.Element(_tag("Category"), {"Name": feature.category, "NameSpace": "Standard"})
            by_name[feature.category] = category
        ElementTree.SubElement(category, _tag("pFeature")).text = feature.name
    top = ElementTree.Element(_tag("Category"), {"Name": ROOT, "NameSpace": "Standard"})
    for name in by_name:
        ElementTree.SubElement(top, _tag("pFeature")).text = name
    root.remove(device)
    for place, category in enumerate([top, *by_name.values()]):
        root.insert(place, category)


class _Writer:
    """Appends the nodes of a feature: the visible one, and the hidden ones of its register."""

    def __init__(self, root: ElementTree.Element, where: Mapping[str, int]) -> None:
        self._root, self._where = root, where

    def feature(self, feature: AnyFeature, selected: list[str]) -> None:
        """Append all nodes of a feature; ``selected``: the features whose instance it chooses."""
        kinds: dict[type, str] = {
            EnumerationFeature: "Enumeration",
            IntegerFeature: "Integer",
            FloatFeature: "Float",
            BooleanFeature: "Boolean",
            CommandFeature: "Command",
            ReadOnlyInteger: "Integer",
        }
        space = OWN_FEATURES.get(feature.name, "Standard")
        node = ElementTree.SubElement(
            self._root, _tag(kinds[type(feature)]), {"Name": feature.name, "NameSpace": space}
        )

        def put(name: str, text: object) -> None:
            ElementTree.SubElement(node, _tag(name)).text = str(text)

        put("ToolTip", feature.tip)
        put("Visibility", "Beginner")
        if feature.shapes or feature.auto is not None:
            put("pIsLocked", f"{feature.name}Locked")
        self._value(feature, node, put)
        for name in selected:
            put("pSelected", name)
        self._lock(feature)
        self._registers(feature)

    def _value(self, feature: AnyFeature, node: ElementTree.Element, put: Callable[[str, object], None]) -> None:
        register = f"{feature.name}Reg"
        match feature:
            case EnumerationFeature():
                for word, number in feature.codes.items():
                    entry = ElementTree.SubElement(node, _tag("EnumEntry"), {"Name": word, "NameSpace": "Standard"})
                    ElementTree.SubElement(entry, _tag("Value")).text = str(number)
                put("pValue", register)
            case IntegerFeature():
                put("pValue", register)
                put("Min", feature.low)
                put(*(("pMax", f"{feature.name}Top") if feature.computed else ("Max", feature.high)))
                put("Inc", feature.step)
            case FloatFeature():
                put("pValue", register)
                put("Min", feature.low)
                put("Max", feature.high)
            case BooleanFeature():
                put("pValue", register)
                put("OnValue", 1)
                put("OffValue", 0)
            case CommandFeature():
                put("pValue", register)
                put("CommandValue", 1)
            case ReadOnlyInteger():
                put("pValue", register)
        if isinstance(feature, IntegerFeature | FloatFeature | ReadOnlyInteger) and feature.unit:
            put("Unit", feature.unit)

    def _lock(self, feature: AnyFeature) -> None:
        """Append the node that says whether the feature is read-only now."""
        if not feature.shapes and feature.auto is None:
            return
        lock = ElementTree.SubElement(self._root, _tag("IntSwissKnife"), {"Name": f"{feature.name}Locked"})
        ElementTree.SubElement(lock, _tag("Visibility")).text = "Invisible"
        # The host's lock, or an automatic function that is not Off, whose number is 0.
        behind = "TLParamsLocked" if feature.auto is None else feature.auto
        ElementTree.SubElement(lock, _tag("pVariable"), {"Name": "HOLDER"}).text = f"{behind}Reg"
        ElementTree.SubElement(lock, _tag("Formula")).text = "HOLDER <> 0"

    def _registers(self, feature: AnyFeature) -> None:
        address = self._where[feature.name]
        access = {CommandFeature: "WO", ReadOnlyInteger: "RO"}.get(type(feature), "RW")
        if isinstance(feature, FloatFeature):
            self._register("FloatReg", f"{feature.name}Reg", address, 8, access)
        else:
            self._register("IntReg", f"{feature.name}Reg", address, 4, access)
        if isinstance(feature, IntegerFeature) and feature.computed:
            self._register("IntReg", f"{feature.name}Top", address + TOP, 4, "RO")

    def _register(self, kind: str, name: str, address: int, length: int, access: str) -> None:
        node = ElementTree.SubElement(self._root, _tag(kind), {"Name": name})
        rows: list[tuple[str, object]] = [
            ("Visibility", "Invisible"),
            ("Address", f"0x{address:X}"),
            ("Length", length),
            ("AccessMode", access),
            ("pPort", "Device"),
            ("Cachable", "NoCache"),
        ]
        if kind == "IntReg":
            rows.append(("Sign", "Unsigned"))
        rows.append(("Endianess", "LittleEndian"))
        for tag, text in rows:
            ElementTree.SubElement(node, _tag(tag)).text = str(text)
