"""Checks of a camera's description before GenApi parses it: its size, and its references.

GenApi parses in native code, recursively and without limits of its own. So a description that is nested deeper, or has
more nodes, than any camera's is refused, and so is one that declares a document type: entities can make a gigabyte of a
kilobyte, or name a file of this machine.

A ``pPort`` that names a node other than a port, or any other reference that names a port, crashes the process in native
code, where no exception can be caught (genicam 1.6). Such a description is refused like any other that cannot be used.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

MAX_DEPTH = 32
"""A description has a root, groups in groups, a node, its entries and their elements: five to eight levels."""
MAX_ELEMENTS = 400_000
"""The largest published descriptions have some 40,000."""
MAX_ATTRIBUTES = 64


class WrongReference(ValueError):
    """The description is not well formed, beyond its limits, or refers to a node of the wrong kind."""


def check_limits(xml: str) -> None:
    """Raise WrongReference for a description too deep or too large, or with a document type."""
    depth = count = 0

    def opened(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth += 1
        count += 1
        if depth > MAX_DEPTH:
            raise WrongReference(f"elements nested deeper than {MAX_DEPTH}")
        if count > MAX_ELEMENTS:
            raise WrongReference(f"more than {MAX_ELEMENTS} elements")
        if len(attributes) > MAX_ATTRIBUTES:
            raise WrongReference(f"an element with more than {MAX_ATTRIBUTES} attributes")

    def closed(name: str) -> None:
        nonlocal depth
        depth -= 1

    def declared(*_: object) -> None:
        raise WrongReference("a document type is declared; descriptions have none")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = declared
    try:
        parser.Parse(xml.encode(), True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # LookupError: an encoding that Python does not know
        raise WrongReference(f"not well-formed XML: {error}") from error


def check_references(xml: str) -> None:
    """Raise WrongReference for a description that would crash GenApi; GenApi checks all else itself."""
    check_limits(xml)
    try:
        root = ElementTree.fromstring(xml.encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise WrongReference(f"not well-formed XML: {error}") from error
    ports = {node.get("Name") for node in root.iter() if _kind(node) == "Port"}
    for node in root.iter():
        kind, name = _kind(node), (node.text or "").strip()
        if kind == "pPort" and name not in ports:
            raise WrongReference(f"pPort names {name[:40]!r}, which is no port")
        if kind.startswith("p") and kind != "pPort" and name in ports:
            raise WrongReference(f"{kind} names {name[:40]!r}, which is a port and no feature")


def _kind(node: ElementTree.Element) -> str:
    """Return the element's name without its name space."""
    return str(node.tag).rpartition("}")[2]
