"""Read a spec: convert its text to an experiment, and report all problems at once.

`load_document` converts the values of a file to the experiment in these steps:

    read_document          the file's data, with the place of each value (`yaml.document`)
    with_settings          values of `--set` and other options take their places (`yaml.settings`);
                           they may name the files below
    _apply_identified      values of the file of `tetractl identify`, if the spec names one, take
                           the places of its own, but not those of settings
    _put_controller_file   contents of the file that the controller's section names, if it does
    validate_experiment    sections, or pydantic's errors in plain words (`explain_errors`); then
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
from tetractl.spec.base import validate_document
from tetractl.spec.consistency import find_errors
from tetractl.spec.controller import ControllerSection, NamedFile
from tetractl.spec.experiment import DEFAULT_CONTROLLER, Experiment
from tetractl.spec.loaded_spec import AttachedFiles, LoadedSpec, attach_file
from tetractl.spec.yaml.document import Document, Place, parse_document, read_document
from tetractl.spec.yaml.problems import InvalidSpecError, Loc, SpecProblem
from tetractl.spec.yaml.settings import SpecSetting, with_settings

IDENTIFIED = ("identified",)
"""The location of the field that names a file of `tetractl identify`."""


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
    effective_document = with_settings(document, settings)
    _refuse_study(effective_document)
    attached: AttachedFiles = ()
    if document.path is None:
        _refuse_named_files(effective_document)
    else:
        effective_document, attached = _apply_identified(effective_document, document, settings)
        attached = _put_controller_file(effective_document, attached)
    experiment = validate_experiment(effective_document, is_resolved=False)
    path = document.path
    name = document.origin if path is None else printable(path.name)
    return LoadedSpec(experiment, document.text, name, path, attached, document=effective_document)


def load_spec(path: Path, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Read and check a spec file, with the values in `settings` in place of its own.

    Raises:
        InvalidSpecError: If the file cannot be read, or if the spec has errors.
    """
    return load_document(read_document(path), settings)


def parse_spec(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check the text of a spec, and return the spec with its experiment.

    The spec must not name a file, because there is no folder to find it in.

    Args:
        text: The text.
        name: Its name in error messages.
        settings: Values that replace those in the text.
    """
    return load_document(parse_document(text, name), settings)


def parse_resolved(text: str, name: str, settings: Sequence[SpecSetting] = ()) -> LoadedSpec:
    """Check a resolved spec that tetractl wrote into a log, and return the loaded spec.

    The places of robots are not checked, because a trial may have measured them.

    Args:
        text: The text.
        name: Its name in error messages.
        settings: Values that replace those in the text.
    """
    document = with_settings(parse_document(text, name), settings)
    _refuse_study(document)
    _refuse_named_files(document)
    experiment = validate_experiment(document, is_resolved=True)
    return LoadedSpec(experiment, text, name, logged=document.data)


def parse_contents(
    contents: Mapping[str, Any], name: str, settings: Sequence[SpecSetting] = ()
) -> LoadedSpec:
    """Check a spec that is given as a mapping, and return the spec with its experiment.

    Problems and warnings name fields but no lines, because there is no file.

    Args:
        contents: The fields of the spec, by key.
        name: Its name in error messages.
        settings: Values that replace those in the contents.
    """
    text = format_as_json(contents, name)
    with omit_line_numbers():
        document = parse_document(text, name)
        for loc, place in document.places.items():
            document.places[loc] = replace(place, line=None, column=None)
        return load_document(document, settings)


@contextmanager
def omit_line_numbers() -> Iterator[None]:
    """Leave out line numbers from spec errors that are raised in the `with` block.

    This is for specs that are given as mappings, because there is no file with lines.
    """
    try:
        yield
    except InvalidSpecError as error:
        problems = [replace(problem, line=None, column=None) for problem in error.problems]
        raise InvalidSpecError(problems, error.hint) from None


def format_as_json(contents: Mapping[str, Any], name: str) -> str:
    """Format the contents of a spec as JSON text on one line, which is also YAML.

    Raises:
        SpecError: If they contain an object that JSON cannot express. The message starts with
            `name`.
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


def _find_file_name(document: Document, loc: Loc) -> str | None:
    """Return the file name that a field of a spec contains.

    None if the field is missing or is not a string.
    """
    name: Any = document.data
    for key in loc:
        name = name.get(key) if isinstance(name, dict) else None
    return name if isinstance(name, str) else None


def _find_controller_file(document: Document) -> tuple[NamedFile, str] | None:
    """Return the file to which the spec's controller refers, and its name in the spec.

    The result is None if the spec names no such file, or has the file's contents itself.
    """
    controller_class = _find_controller_class(document)
    named = controller_class.named_file if controller_class is not None else None
    if named is None or ("controller", named.contents) in document.places:
        return None
    file_name = _find_file_name(document, ("controller", named.field))
    return None if file_name is None else (named, file_name)


def _apply_identified(
    effective_document: Document, document: Document, settings: Sequence[SpecSetting]
) -> tuple[Document, AttachedFiles]:
    """Apply the values of the `tetractl identify` file that a spec names, if it names one.

    These values replace the spec's own values, and settings replace both.

    Args:
        effective_document: The document with its settings, which may name the file.
        document: The document without the settings.
        settings: The settings.

    Returns:
        The document with its settings and these values, and the file for the log.
    """
    file_name = _find_file_name(effective_document, IDENTIFIED)
    if file_name is None:
        return effective_document, ()
    from tetractl.spec.identified import merge_identified, read_identified

    path = _folder(document) / file_name
    identified, text = read_identified(path)
    identified_spec = with_settings(document, ())
    merge_identified(identified_spec, identified, str(path), _identifies_robots(effective_document))
    effective_document = with_settings(identified_spec, settings)
    effective_document.remove(IDENTIFIED)  # its values are now in the spec
    return effective_document, attach_file((), path, text)


def _put_controller_file(effective_document: Document, attached: AttachedFiles) -> AttachedFiles:
    """Replace the name of the controller's file, if there is one, by the file's contents.

    Returns:
        The files for the log, including the controller's file.
    """
    controller_file = _find_controller_file(effective_document)
    if controller_file is None:
        return attached
    named, file_name = controller_file
    path = _folder(effective_document) / file_name
    contents, text = named.read(path)
    effective_document.remove(("controller", named.field))
    effective_document.put(("controller", named.contents), contents, Place(str(path)))
    return attach_file(attached, path, text)


def _folder(document: Document) -> Path:
    """Return the folder of a document's file. The document must come from a file."""
    assert document.path is not None, "a document that comes from no file names none"
    return document.path.parent


def _refuse_named_files(document: Document) -> None:
    """Add a problem for each file that the spec refers to, because there is no folder for it.

    The problems are stored in the document, and nothing is raised.
    """
    refusal = "can be named only in a spec file"
    if _find_file_name(document, IDENTIFIED) is not None:
        document.refuse(IDENTIFIED, refusal)
    controller_file = _find_controller_file(document)
    if controller_file is not None:
        named, _ = controller_file
        document.refuse(("controller", named.field), refusal)


def _identifies_robots(document: Document) -> bool:
    """Check whether the controller of a spec identifies robots while it drives.

    Its field `estimate` decides or, if the field is missing, the default of the controller's kind.
    """
    controller_class = _find_controller_class(document)
    if controller_class is None:
        return False
    estimate_field = controller_class.model_fields.get("estimate")
    by_default = estimate_field is not None and estimate_field.default
    return document.data.get("controller", {}).get("estimate", by_default) is True


def _find_controller_class(document: Document) -> type[ControllerSection] | None:
    """Find the class of a spec's controller section.

    A controller without a type is the default controller. The result is None if no installed kind
    has the given type.
    """
    controller = document.data.get("controller", {})
    if not isinstance(controller, dict):
        return None
    name = controller.get("type", DEFAULT_CONTROLLER)
    if not isinstance(name, str) or name not in CONTROLLERS:
        return None
    return CONTROLLERS.load(name)


def validate_experiment(document: Document, is_resolved: bool) -> Experiment:
    """Check a parsed spec, and return the experiment that it describes.

    Args:
        document: The parsed spec.
        is_resolved: Whether tetractl has written the spec into a log. Then the places of robots are
            not checked.

    Raises:
        InvalidSpecError: With all wrong values at once or, if there are none, with all
            contradictions.
    """
    experiment = validate_document(Experiment, document)
    with np.errstate(all="ignore"):  # numbers at the end of floating point are compared as inf
        for error in find_errors(experiment, is_resolved):
            document.refuse(error.loc, str(error))
    document.require_no_problems()
    return experiment
