"""`tetractl schema`: prints the JSON schema of a spec or a study."""

from pathlib import Path
from typing import Annotated

import typer


def schema(
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="File to write the schema to."),
    ] = None,
    study: Annotated[
        bool,
        typer.Option("--study", help="Print the schema of a study in place of a spec's."),
    ] = False,
) -> None:
    """Print the JSON schema of a spec, or of a study, for editors.

    Example: tetractl schema -o experiment.schema.json
    """
    from tetractl.experiment.yaml.schema import experiment_schema, schema_json

    if study:
        from tetractl.study.load_study import study_schema

        text = schema_json(study_schema())
    else:
        text = schema_json(experiment_schema())
    if out is None:
        print(text, end="")
    else:
        out.write_text(text, encoding="utf-8")
