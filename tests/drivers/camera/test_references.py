"""What is asked of a description before native code sees it: exactly at the limits, and one beyond."""

from __future__ import annotations

import pytest

from drivers.camera.references import WrongReference, check_limits, check_references


def test_a_description_may_be_nested_32_deep_and_not_deeper() -> None:
    check_limits("<a>" * 32 + "</a>" * 32)
    check_limits("<a>" + "<b></b>" * 40 + "</a>")
    with pytest.raises(WrongReference, match="nested deeper than 32"):
        check_limits("<a>" * 33 + "</a>" * 33)


def test_a_description_may_have_400_000_elements_and_no_more() -> None:
    check_limits("<a>" + "<b/>" * 399_999 + "</a>")
    with pytest.raises(WrongReference, match="more than 400000 elements"):
        check_limits("<a>" + "<b/>" * 400_000 + "</a>")


def test_an_element_may_have_64_attributes_and_no_more() -> None:
    check_limits("<a {}/>".format(" ".join(f"x{k}='1'" for k in range(64))))
    with pytest.raises(WrongReference, match="more than 64 attributes"):
        check_limits("<a {}/>".format(" ".join(f"x{k}='1'" for k in range(65))))


@pytest.mark.parametrize("xml", ["<a>", "<a/><b/>", "", "<?xml version='1.0' encoding='no-such'?><a/>"])
def test_what_is_not_well_formed_is_said_to_be_so(xml: str) -> None:
    for check in (check_limits, check_references):
        with pytest.raises(WrongReference, match="not well-formed XML"):
            check(xml)


def test_declarations_are_refused_before_they_take_effect() -> None:
    for inside in ("", "[<!ENTITY e 'x'>]"):
        with pytest.raises(WrongReference, match="a document type is declared"):
            check_limits(f"<!DOCTYPE a {inside}><a/>")


def described(*references: str) -> str:
    body = "".join(references)
    return (
        f"<R xmlns='http://www.genicam.org/GenApi/Version_1_1'><Integer Name='Width'/><Port Name='Device'/>{body}</R>"
    )


def test_a_port_is_named_where_a_port_belongs_and_nowhere_else() -> None:
    check_references(described("<I Name='a'><pPort> Device </pPort><pValue>Width</pValue></I>"))
    check_references(described("<I Name='a'><Address>Device</Address></I>"))
    with pytest.raises(WrongReference, match="pPort names 'Width', which is no port"):
        check_references(described("<I Name='a'><pPort>Width</pPort></I>"))
    with pytest.raises(WrongReference, match="pPort names '', which is no port"):
        check_references(described("<I Name='a'><pPort/></I>"))
    with pytest.raises(WrongReference, match="pValue names 'Device', which is a port and no feature"):
        check_references(described("<I Name='a'><pValue>Device</pValue></I>"))


def test_a_wrong_name_is_quoted_no_longer_than_40_letters() -> None:
    with pytest.raises(WrongReference) as caught:
        check_references(described(f"<I Name='a'><pPort>{'x' * 5000}</pPort></I>"))
    assert f"'{'x' * 40}'" in str(caught.value)
