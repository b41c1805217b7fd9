"""The generated protobuf modules belong to tetractl.proto."""

import re
import sys
from pathlib import Path

import pytest

import tetractl.log

FOLDER = Path(tetractl.log.__file__).parent


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
            f"-I{FOLDER.parents[1]}",
            f"--python_out={tmp_path}",
            f"--pyi_out={tmp_path}",
            str(source),
        ]
    )
    assert code == 0
    fresh = (tmp_path / "tetractl/log" / name).read_text()
    assert _unversioned(fresh) == _unversioned((FOLDER / name).read_text()), (
        f"run: {Path(sys.executable).name} -m grpc_tools.protoc -I. --python_out=. --pyi_out=. "
        "tetractl/log/tetractl.proto"
    )
