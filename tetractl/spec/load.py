"""Read a spec: convert its text to an experiment, and report all problems at once.

`load_document` converts the values of a file to the experiment in these steps:

    read_document          the file's data, with the place of each value (`yaml.document`)
    with_settings          values of `--set` and other options take their places (`yaml.settings`);
                           they may name the files below
    _with_identified       values of the file of `tetractl identify`, if the spec names one, take
                           the places of its own, but not those of settings
    _put_controller_file   contents of the file that the controller's section names, if it does
    validated_experiment   sections, or pydantic's errors in plain words (`explain_errors`); then
                           the rules between sections (`consistency`)

Problems of settings, values and rules are collected, and raised together with their places; a file
that cannot be read is an error at once.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.errors import SpecError, printable
from tetractl.core.registries import CONTROLLERS
from tetractl.spec.base import validated
from tetractl.spec.consistency import find_errors
from tetractl.spec.controller import ControllerSection, NamedFile
from tetractl.spec.experiment import DEFAULT_CONTROLLER, Experiment
from tetractl.spec.loaded_spec import Attached, LoadedSpec, attach
from tetractl.spec.yaml.document import Document, Place, parse_document, read_document
from tetractl.spec.yaml.problems import InvalidSpecError, Loc, SpecProblem
from tetractl.spec.yaml.settings import SpecSetting, with_settings

IDENTIFIED = ("identified",)
"""The field that names a file of `tetractl identify`."""


def load_document(document: Document, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check a parsed spec, and return it with its experiment.

    The document stays as it is. A spec that comes from no file must not name any, because there is
    no folder to find it in.

    Args:
        document: The parsed spec. The files that it names are in the folder of its own file.
        settings: Values that replace those of the document.

    Raises:
        InvalidSpecError: With one line per problem: `file:line:column: field: value: what is wrong;
            what would be right`.
    """
    settled = with_settings(document, settings)
    _refuse_study(settled)
    attached: Attached = ()
    if document.path is None:
        _refuse_named_files(settled)
    else:
        settled, attached = _with_identified(settled, document, settings)
        attached = _put_controller_file(settled, attached)
    experiment = validated_experiment(settled, written=False)
    path = document.path
    name = document.origin if path is None else printable(path.name)
    return LoadedSpec(experiment, document.text, name, path, attached, document=settled)


def load_spec(path: Path, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Read and check a spec file, with the values in `settings` in place of its own.

    Raises:
        InvalidSpecError: If the file cannot be read, or if the spec has errors.
    """
    return load_document(read_document(path), settings)


def parse_spec(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check the text of a spec, as `load_document` does.

    The spec must not name a file, because there is no folder to find it in.

    Args:
        text: The text.
        name: Its name in error messages.
        settings: Values that replace those in the text.
    """
    return load_document(parse_document(text, name), settings)


def parse_written(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check a resolved spec that tetractl wrote into a log.

    Its places are not checked, because a trial may have measured them.

    Args:
        text: The text.
        name: Its name in error messages.
        settings: Values that replace those in the text.
    """
    document = with_settings(parse_document(text, name), settings)
    _refuse_study(document)
    _refuse_named_files(document)
    experiment = validated_experiment(document, written=True)
    return LoadedSpec(experiment, text, name, logged=document.data)


def parse_contents(
    contents: Mapping[str, Any], name: str, settings: Sequence[SpecSetting] = ()
) -> LoadedSpec:
    """Check a spec given as its contents, as `parse_spec` does.

    Problems and warnings name fields but no lines, because there is no file.

    Args:
        contents: The contents.
        name: Its name in error messages.
        settings: Values that replace those in the contents.
    """
    text = as_text(contents, name)
    with without_lines():
        document = parse_document(text, name)
        for loc, place in document.places.items():
            document.places[loc] = replace(place, line=None, column=None)
        return load_document(document, settings)


@contextmanager
def without_lines() -> Iterator[None]:
    """In the block, raise problems of contents without line numbers, because there is no file."""
    try:
        yield
    except InvalidSpecError as error:
        problems = [replace(problem, line=None, column=None) for problem in error.problems]
        raise InvalidSpecError(problems, error.hint) from None


def as_text(contents: Mapping[str, Any], name: str) -> str:
    """Return the contents of a spec as JSON text on one line, which is also YAML.

    Raises:
        SpecError: If they hold an object that JSON lacks. The message starts with `name`.
    """
    try:
        return json.dumps(contents)
    except (TypeError, ValueError) as error:
        hint = "give strings, numbers, lists and dicts; convert arrays with array.tolist()"
        raise SpecError(f"{name}: {printable(str(error), 200)}", hint) from None


def is_study(document: Document) -> bool:
    """Check whether a file is a study: it has the key `base`, but not the key `robots`."""
    return "base" in document.data and "robots" not in document.data


def _refuse_study(document: Document) -> None:
    if is_study(document):
        hint = f"run it with: tetractl study {document.origin}"
        raise InvalidSpecError([SpecProblem(document.origin, "this is a study, not a spec")], hint)


def _named_file(document: Document, loc: Loc) -> str | None:
    """Return the name of the file that a field of a spec refers to.

    None if the field is missing or is not a string.
    """
    name: Any = document.data
    for key in loc:
        name = name.get(key) if isinstance(name, dict) else None
    return name if isinstance(name, str) else None


def _controller_file(document: Document) -> tuple[NamedFile, str] | None:
    """Return the file to which the spec's controller refers, and its name in the spec.

    The result is None if the spec names no such file, or has the file's contents itself.
    """
    kind = _controller_kind(document)
    named = kind.named_file if kind is not None else None
    if named is None or ("controller", named.contents) in document.places:
        return None
    file_name = _named_file(document, ("controller", named.field))
    return None if file_name is None else (named, file_name)


def _with_identified(
    settled: Document, document: Document, settings: Sequence[SpecSetting]
) -> tuple[Document, Attached]:
    """Take the values of the `tetractl identify` file that a spec names, if it names one.

    These values replace the spec's own values, and settings replace both.

    Args:
        settled: The document with its settings, which may name the file.
        document: The document without them.
        settings: The settings.

    Returns:
        The settled document, with these values, and the file for the log.
    """
    file_name = _named_file(settled, IDENTIFIED)
    if file_name is None:
        return settled, ()
    from tetractl.spec.identified import merge, read_identified

    path = _folder(document) / file_name
    identified, text = read_identified(path)
    identified_spec = with_settings(document, ())
    merge(identified_spec, identified, str(path), _estimates(settled))
    settled = with_settings(identified_spec, settings)
    settled.take_out(IDENTIFIED)  # its values are now in the spec
    return settled, attach((), path, text)


def _put_controller_file(settled: Document, attached: Attached) -> Attached:
    """Replace the name of the controller's file, if there is one, by the file's contents.

    Returns:
        The files for the log, with this one.
    """
    controller_file = _controller_file(settled)
    if controller_file is None:
        return attached
    named, file_name = controller_file
    path = _folder(settled) / file_name
    contents, text = named.read(path)
    settled.take_out(("controller", named.field))
    settled.put(("controller", named.contents), contents, Place(str(path)))
    return attach(attached, path, text)


def _folder(document: Document) -> Path:
    """Return the folder of a document's file. The document must come from a file."""
    assert document.path is not None, "a document that comes from no file names none"
    return document.path.parent


def _refuse_named_files(document: Document) -> None:
    """Add a problem for each file that the spec refers to, because there is no folder for it.

    The problems are stored in the document, and nothing is raised.
    """
    refusal = "can be named only in a spec file"
    if _named_file(document, IDENTIFIED) is not None:
        document.refuse(IDENTIFIED, refusal)
    controller_file = _controller_file(document)
    if controller_file is not None:
        named, _ = controller_file
        document.refuse(("controller", named.field), refusal)


def _estimates(document: Document) -> bool:
    """Check whether a document's controller identifies robots while it drives.

    Its field `estimate` says so or, if it is missing, the default of its kind.
    """
    kind = _controller_kind(document)
    if kind is None:
        return False
    field_of_kind = kind.model_fields.get("estimate")
    by_default = field_of_kind is not None and field_of_kind.default
    return document.data.get("controller", {}).get("estimate", by_default) is True


def _controller_kind(document: Document) -> type[ControllerSection] | None:
    """Return the class of a document's controller.

    A spec without a type has the default controller. None if no installed kind has the given type.
    """
    controller = document.data.get("controller", {})
    if not isinstance(controller, dict):
        return None
    name = controller.get("type", DEFAULT_CONTROLLER)
    if not isinstance(name, str) or name not in CONTROLLERS:
        return None
    return CONTROLLERS.load(name)


def validated_experiment(document: Document, written: bool) -> Experiment:
    """Check a document, and return the experiment that it describes.

    Raises:
        InvalidSpecError: With all wrong values at once or, if there are none, with all
            contradictions.
    """
    experiment = validated(Experiment, document)
    with np.errstate(all="ignore"):  # numbers at the end of floating point are compared as inf
        for error in find_errors(experiment, written):
            document.refuse(error.where, str(error))
    document.require_no_problems()
    return experiment
