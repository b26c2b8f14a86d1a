"""The camera's registers and its GenICam description, which come from one table."""

import io
import struct
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest

from gige_vision import bootstrap
from gige_vision.gvcp import Status
from virtual_studio.gige.device import OLD, SFNC, CameraSettings
from virtual_studio.gige.feature_table import feature_table
from virtual_studio.gige.genicam_xml import genicam_xml, zipped
from virtual_studio.gige.registers import FILE_SPACE, Kind, RegisterError, Registers

NAMESPACE = "{http://www.genicam.org/GenApi/Version_1_1}"


def table(generation=SFNC, colour=True):
    return feature_table(CameraSettings(generation=generation), "127.0.0.9", 640, 480, colour)


def registers():
    return Registers(table(), b"0123456789abcdef")


def status_of(action):
    with pytest.raises(RegisterError) as refused:
        action()
    return refused.value.status


@pytest.mark.parametrize("generation", [SFNC, OLD])
def test_description_refers_to_what_it_describes_and_to_readable_registers(generation):
    features = table(generation)
    root, memory = ElementTree.fromstring(genicam_xml(features, "V", "M")), Registers(features)
    nodes = {node.get("Name") for node in root.iter() if node.get("Name") and node.tag != NAMESPACE + "EnumEntry"}
    tags = ("pFeature", "pValue", "pMin", "pMax", "pPort", "pSelected")
    references = [node.text for tag in tags for node in root.iter(NAMESPACE + tag)]
    assert len(references) > 150 and set(references) <= nodes
    registers = [
        node for tag in ("IntReg", "FloatReg", "MaskedIntReg", "StringReg") for node in root.iter(NAMESPACE + tag)
    ]
    registers = [node for node in registers if node.findtext(NAMESPACE + "pPort") == "Device"]
    assert len(registers) > 60
    for node in registers:
        address, length = int(node.findtext(NAMESPACE + "Address"), 16), int(node.findtext(NAMESPACE + "Length"))
        assert len(memory.read(address, length)) == length, node.get("Name")


def test_generations_differ_in_names_and_agree_in_keys():
    new, old = ({f.key: f.name for f in table(g) if f.name} for g in (SFNC, OLD))
    assert set(new) == set(old)
    assert (new["ExposureTime"], old["ExposureTime"]) == ("ExposureTime", "ExposureTimeAbs")
    assert (new["PtpEnable"], old["PtpEnable"]) == ("PtpEnable", "GevIEEE1588")


def test_zipped_description_is_whole_words_and_unpacks_to_the_same():
    xml = genicam_xml(table(), "V", "M")
    packed = zipped(xml)
    assert len(packed) % 4 == 0
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        assert archive.read(archive.namelist()[0]).decode() == xml


def test_accesses_are_refused_with_the_status_that_says_why():
    memory = registers()
    at = {f.key: f.address for f in table() if f.has_register}
    assert status_of(lambda: memory.read(0x9000, 4)) == Status.INVALID_ADDRESS
    assert status_of(lambda: memory.read(at["Width"] + 1, 4)) == Status.BAD_ALIGNMENT
    assert status_of(lambda: memory.read(at["Width"], 3)) == Status.BAD_ALIGNMENT
    assert status_of(lambda: memory.write(at["SensorWidth"], bytes(4))) == Status.WRITE_PROTECT
    assert status_of(lambda: memory.write(at["Width"], struct.pack(">I", 642))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["Width"], struct.pack(">I", 644))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["PixelFormat"], struct.pack(">I", 7))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.write(at["ExposureTime"], struct.pack(">d", np.nan))) == Status.INVALID_PARAMETER
    assert status_of(lambda: memory.read(FILE_SPACE + 16, 4)) == Status.INVALID_ADDRESS
    assert memory.read(FILE_SPACE + 4, 8) == b"456789ab"
    assert memory.integer("Width") == 640


def test_refused_write_of_several_registers_changes_none_of_them():
    memory = registers()
    words = struct.pack(">IIII", 50_000, 9000, 7, 0)  # port, packet size, packet delay, and then no register
    assert status_of(lambda: memory.write(bootstrap.STREAM_PORT, words)) == Status.INVALID_ADDRESS
    assert memory.integer("GevSCPHostPort") == 0
    memory.write(bootstrap.STREAM_PORT, words[:12])
    assert [memory.integer(key) for key in ("GevSCPHostPort", "PacketSizeWord", "GevSCPD")] == [50_000, 9000, 7]


@pytest.mark.parametrize("colour", [False, True])
def test_colour_formats_are_offered_by_a_colour_camera_alone(colour):
    formats = next(f for f in table(colour=colour) if f.key == "PixelFormat")
    assert formats.kind is Kind.ENUMERATION and ("BayerRG8" in dict(formats.entries)) is colour
