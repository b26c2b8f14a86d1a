"""Writes a camera's GenICam description from the table of its features."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable
from xml.sax.saxutils import escape

from .registers import Feature, Kind

XML_NAME = "sagoma_studio_camera"
_HEAD = (
    '<?xml version="1.0" encoding="utf-8"?>\n'
    '<RegisterDescription ModelName="{model}" VendorName="{vendor}" StandardNameSpace="GEV" SchemaMajorVersion="1" '
    'SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
    'ProductGuid="5f1b1c2e-6d1b-4a5e-9c57-000000000001" VersionGuid="5f1b1c2e-6d1b-4a5e-9c57-000000000002" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1" '
    'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1 '
    'http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd">\n'
)
PORT = "Device"


def genicam_xml(features: Iterable[Feature], vendor: str, model: str) -> str:
    """Writes the XML: categories, a node for every named feature, and a register node beneath each."""
    named = [feature for feature in features if feature.name]
    names = {feature.key: feature.name for feature in named}
    parts = [_HEAD.format(vendor=escape(vendor), model=escape(model)), *_categories(named)]
    for feature in named:
        parts.append(_node(feature, names))
        if feature.kind is not Kind.STRING:
            parts.append(_register(feature))
        if feature.chunk:
            parts.append(f'<Port Name="{_port(feature)}"><ChunkID>{feature.chunk:X}</ChunkID></Port>\n')
    parts.append(f'<Port Name="{PORT}"/>\n</RegisterDescription>\n')
    return "".join(parts)


def zipped(xml: str) -> bytes:
    """Zips the XML, as cameras may hold it: a tenth of the bytes to read over GVCP."""
    plain = _zip(xml, b"")
    return _zip(xml, b" " * (-len(plain) % 4))  # cameras are read in whole words


def _zip(xml: str, comment: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(zipfile.ZipInfo(f"{XML_NAME}.xml", (2026, 1, 1, 0, 0, 0)), xml, zipfile.ZIP_DEFLATED)
        archive.comment = comment
    return buffer.getvalue()


def _categories(features: list[Feature]) -> list[str]:
    names = list(dict.fromkeys(feature.category for feature in features if feature.category))
    parts = [_element("Category", "Root", "".join(f"<pFeature>{name}</pFeature>" for name in names))]
    for name in names:
        members = "".join(f"<pFeature>{f.name}</pFeature>" for f in features if f.category == name)
        parts.append(_element("Category", name, members))
    return parts


def _node(feature: Feature, names: dict[str, str]) -> str:
    tip = f"<ToolTip>{escape(feature.help)}</ToolTip>" if feature.help else ""
    if feature.kind is Kind.STRING:
        body = f"{tip}<Address>0x{feature.address:X}</Address><Length>{feature.length}</Length>"
        return _element("StringReg", feature.name, f"{body}{_access(feature)}<pPort>{PORT}</pPort>")
    value = f"<pValue>{feature.name}Reg</pValue>"
    if feature.kind is Kind.ENUMERATION:
        value = "".join(_element("EnumEntry", n, f"<Value>{v}</Value>") for n, v in feature.entries) + value
    elif feature.kind is Kind.COMMAND:
        value += "<CommandValue>1</CommandValue>"
    elif feature.kind is Kind.BOOLEAN:
        value += "<OnValue>1</OnValue><OffValue>0</OffValue>"
    else:
        value += _limits(feature, names)
        value += f"<Unit>{escape(feature.unit)}</Unit>" if feature.unit else ""
    selected = "<pSelected>ChunkEnable</pSelected>" if feature.key == "ChunkSelector" else ""
    return _element(feature.kind.value, feature.name, tip + value + selected)


def _limits(feature: Feature, names: dict[str, str]) -> str:
    numbers = {"Min": feature.low, "Max": feature.high, "Inc": feature.step}
    limits = "".join(f"<{tag}>{number!r}</{tag}>" for tag, number in numbers.items() if number is not None)
    return limits + (f"<pMax>{names[feature.high_key]}</pMax>" if feature.high_key else "")


def _register(feature: Feature) -> str:
    where = f"<Address>0x{0 if feature.chunk else feature.address:X}</Address><Length>{feature.length}</Length>"
    where += f"{_access(feature)}<pPort>{_port(feature)}</pPort>"
    where += "<Cachable>NoCache</Cachable>" if feature.volatile or feature.chunk or feature.bits else ""
    name = f"{feature.name}Reg"
    if feature.kind is Kind.FLOAT:
        return _element("FloatReg", name, f"{where}<Endianess>BigEndian</Endianess>")
    sign = "<Sign>Signed</Sign>" if feature.unit == "ns" and feature.length == 8 else "<Sign>Unsigned</Sign>"
    if feature.bits is None:
        return _element("IntReg", name, f"{where}{sign}<Endianess>BigEndian</Endianess>")
    first, last = (31 - bit for bit in feature.bits)  # in big-endian registers bit 0 is the highest
    bits = f"<Bit>{first}</Bit>" if first == last else f"<LSB>{first}</LSB><MSB>{last}</MSB>"
    return _element("MaskedIntReg", name, f"{where}{bits}{sign}<Endianess>BigEndian</Endianess>")


def _access(feature: Feature) -> str:
    return f"<AccessMode>{'RW' if feature.writable else 'RO'}</AccessMode>"


def _port(feature: Feature) -> str:
    return f"{feature.name}Port" if feature.chunk else PORT


def _element(tag: str, name: str, body: str) -> str:
    return f'<{tag} Name="{name}">{body}</{tag}>\n'
