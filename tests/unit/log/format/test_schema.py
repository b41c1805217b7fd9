"""Tests that the generated protobuf modules and the reference match tetractl.proto."""

import re
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.records import Attachment
from testkit.paths import ROOT
from testkit.random_trials import trial, write

import tetractl.log.format
from tetractl.core.loggable import LOGGED_ESTIMATE_FIELDS
from tetractl.log.format import tetractl_pb2
from tetractl.log.format.channels import CHANNELS, HOST
from tetractl.log.read.salvage import scan

FOLDER = Path(tetractl.log.format.__file__).parent


def test_the_generated_code_is_up_to_date(tmp_path):
    protoc = pytest.importorskip("grpc_tools.protoc", reason="grpcio-tools is not installed")
    descriptors = tmp_path / "descriptors"
    words = [
        f"-I{FOLDER.parents[2]}",
        f"--descriptor_set_out={descriptors}",
        str(FOLDER / "tetractl.proto"),
    ]
    assert protoc.main(["protoc", *words]) == 0
    (fresh,) = FileDescriptorSet.FromString(descriptors.read_bytes()).file
    for message in fresh.message_type:
        for field in message.field:
            field.ClearField("json_name")  # the generated code leaves it out
    ours = FileDescriptorProto()
    tetractl_pb2.DESCRIPTOR.CopyToProto(ours)
    assert ours == fresh, "run: make proto"


def test_the_oldest_protobuf_that_is_allowed_reads_the_generated_code():
    """Regression: code of a newer compiler refused to be imported."""
    lowest = re.search(r'"protobuf>=([\d.]+)"', (ROOT / "pyproject.toml").read_text())[1]
    code = Path(tetractl_pb2.__file__).read_text()
    compiler = re.search(r"Protobuf Python Version: ([\d.]+)", code)[1]
    assert _numbers(compiler) <= _numbers(lowest)


def _numbers(version):
    return tuple(map(int, version.split(".")))


def test_the_reference_names_every_channel_field_and_fact(tmp_path):
    page = (ROOT / "docs" / "reference" / "log-format.md").read_text()
    words = set(re.findall(r"`([^`\s]+)`", page))
    assert words >= CHANNELS.keys()
    for message in CHANNELS.values():
        assert message.DESCRIPTOR.full_name in words
    for name, message in tetractl_pb2.DESCRIPTOR.message_types_by_name.items():
        assert {field.name for field in message.fields} <= words, name
    for record in scan(write(trial(steps=1), tmp_path / "trial.mcap")).records:
        if isinstance(record, Attachment):
            assert record.name in words
        elif record.topic == HOST:
            assert words >= {fact.key for fact in tetractl_pb2.Host.FromString(record.data).facts}


def test_an_estimate_has_the_fields_of_its_message():
    """They are stated twice, so that checks of a controller's plans need no log."""
    assert tuple(tetractl_pb2.Estimate.DESCRIPTOR.fields_by_name) == LOGGED_ESTIMATE_FIELDS
