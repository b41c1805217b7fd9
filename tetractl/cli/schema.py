"""`tetractl schema`: the JSON schema of a spec."""

from pathlib import Path
from typing import Annotated

import typer


def schema(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write it to a file.")
    ] = None,
) -> None:
    """Print the JSON schema of a spec, for editors.

    Example: tetractl schema -o experiment.schema.json
    """
    from tetractl.experiment.yaml.schema import schema_json

    if out is None:
        print(schema_json(), end="")
    else:
        out.write_text(schema_json(), encoding="utf-8")
