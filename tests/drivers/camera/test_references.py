"""What is asked of a description before native code sees it: exactly at the limits, and one beyond."""

from __future__ import annotations

import pytest

from drivers.camera.references import WrongReference, check_limits, check_references

ATTRIBUTES = [f"x{k}='1'" for k in range(65)]


@pytest.mark.parametrize(
    ("fits", "beyond", "said"),
    [
        ("<a>" * 32 + "</a>" * 32, "<a>" * 33 + "</a>" * 33, "nested deeper than 32"),
        ("<a>" + "<b></b>" * 40 + "</a>", "<!DOCTYPE a ><a/>", "a document type is declared"),
        ("<a/>", "<!DOCTYPE a [<!ENTITY e 'x'>]><a/>", "a document type is declared"),
        ("<a>" + "<b/>" * 399_999 + "</a>", "<a>" + "<b/>" * 400_000 + "</a>", "more than 400000 elements"),
        (f"<a {' '.join(ATTRIBUTES[1:])}/>", f"<a {' '.join(ATTRIBUTES)}/>", "more than 64 attributes"),
    ],
    ids=["depth", "no type", "no entity", "elements", "attributes"],
)
def test_a_description_may_be_so_large_and_not_larger(fits: str, beyond: str, said: str) -> None:
    check_limits(fits)
    with pytest.raises(WrongReference, match=said):
        check_limits(beyond)


@pytest.mark.parametrize("xml", ["<a>", "<a/><b/>", "", "<?xml version='1.0' encoding='no-such'?><a/>"])
def test_what_is_not_well_formed_is_said_to_be_so(xml: str) -> None:
    for check in (check_limits, check_references):
        with pytest.raises(WrongReference, match="not well-formed XML"):
            check(xml)


def described(body: str) -> str:
    return (
        f"<R xmlns='http://www.genicam.org/GenApi/Version_1_1'><Integer Name='Width'/><Port Name='Device'/>{body}</R>"
    )


def test_a_port_is_named_where_a_port_belongs_and_nowhere_else() -> None:
    check_references(described("<I Name='a'><pPort> Device </pPort><pValue>Width</pValue></I>"))
    check_references(described("<I Name='a'><Address>Device</Address></I>"))
    for inside, said in (
        ("<pPort>Width</pPort>", "pPort names 'Width', which is no port"),
        ("<pPort/>", "pPort names '', which is no port"),
        ("<pValue>Device</pValue>", "pValue names 'Device', which is a port and no feature"),
        (f"<pPort>{'x' * 5000}</pPort>", f"'{'x' * 40}'"),
    ):
        with pytest.raises(WrongReference, match=said):
            check_references(described(f"<I Name='a'>{inside}</I>"))
