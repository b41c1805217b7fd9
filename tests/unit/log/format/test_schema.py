"""The generated protobuf modules and the reference belong to tetractl.proto."""

import re
import sys
from pathlib import Path

import pytest
from mcap.records import Attachment, Metadata
from support.paths import ROOT
from support.random_trials import trial, write

import tetractl.log.format
from tetractl.log.format import tetractl_pb2
from tetractl.log.format.channels import CHANNELS
from tetractl.log.read.salvage import scan

FOLDER = Path(tetractl.log.format.__file__).parent


def _unversioned(text: str) -> str:
    """Generated code without the versions of the tool that made it."""
    text = re.sub(r"(# Protobuf Python Version: ).*", r"\1", text)
    return re.sub(r"(Domain\.PUBLIC,\n)(?: +\d+,\n)+", r"\1", text)


@pytest.mark.parametrize("name", ["tetractl_pb2.py", "tetractl_pb2.pyi"])
def test_the_generated_code_is_up_to_date(tmp_path: Path, name: str) -> None:
    protoc = pytest.importorskip("grpc_tools.protoc", reason="grpcio-tools is not installed")
    source = FOLDER / "tetractl.proto"
    code = protoc.main(
        [
            "protoc",
            f"-I{FOLDER.parents[2]}",
            f"--python_out={tmp_path}",
            f"--pyi_out={tmp_path}",
            str(source),
        ]
    )
    assert code == 0
    fresh = (tmp_path / "tetractl/log/format" / name).read_text()
    assert _unversioned(fresh) == _unversioned((FOLDER / name).read_text()), (
        f"run: {Path(sys.executable).name} -m grpc_tools.protoc -I. --python_out=. --pyi_out=. "
        "tetractl/log/format/tetractl.proto"
    )


def test_the_reference_names_every_channel_field_and_fact(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "reference" / "log-format.md").read_text()
    words = set(re.findall(r"`([^`\s]+)`", page))
    assert words >= CHANNELS.keys()
    for message in CHANNELS.values():
        assert message.DESCRIPTOR.full_name in words
    for name, message in tetractl_pb2.DESCRIPTOR.message_types_by_name.items():
        assert {field.name for field in message.fields} <= words, name
    for record in scan(write(trial(steps=1), tmp_path / "trial.mcap")).records:
        if isinstance(record, Metadata):
            facts = {fact for fact in record.metadata if not fact.startswith("plant.")}
            assert words >= {record.name, *facts}
        elif isinstance(record, Attachment):
            assert record.name in words
