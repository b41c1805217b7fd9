"""A spec's text as plain data, with the place of each value: where it is written, or what put it.

A location is a tuple of keys and list indices, such as ("robots", 0, "a"). A value that is put into
a document (by `--set`, by another option, or from a file that the spec names) takes the place of
what put it: problems with this value name that option or file.
"""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from tetractl.core.errors import SpecError, printable
from tetractl.spec.yaml.core_yaml import (
    CORE,
    MAX_DEPTH,
    STR,
    compose,
    scalar,
    short_tag,
    within_limits,
)
from tetractl.spec.yaml.problems import (
    SHOWN_LENGTH,
    InvalidSpecError,
    Loc,
    SpecProblem,
    dotted,
    near_files,
)

MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Place:
    """The file, line and column (from 1) of a value or a key, and the text of that value or key.

    Of a value in a mapping, `key` is the place of its key. `refused` is the problem of a value that
    YAML's core schema does not allow; the data has None in its stead.
    """

    origin: str
    line: int | None = None
    column: int | None = None
    text: str | None = None
    key: "Place | None" = None
    refused: SpecProblem | None = None

    def problem(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Return a problem at this location."""
        return SpecProblem(self.origin, message, self.line, self.column, dotted(loc), value)


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed spec: its data, the place of every value in it, and problems so far.

    `text` is the spec as written, and `path` its file, None for a text that comes from no file.
    """

    origin: str
    data: dict[str, Any] = field(default_factory=dict)
    places: dict[Loc, Place] = field(default_factory=dict)
    problems: list[SpecProblem] = field(default_factory=list)
    text: str = field(default="", repr=False)
    path: Path | None = None

    @property
    def all_problems(self) -> list[SpecProblem]:
        """The document's problems so far, including refused values."""
        refused = [place.refused for place in self.places.values() if place.refused]
        return [*self.problems, *refused]

    def require_no_problems(self) -> None:
        """Raise InvalidSpecError with the problems so far, if there are any."""
        if self.all_problems:
            raise InvalidSpecError(self.all_problems)

    def key(self, loc: Loc) -> Place:
        """Return the place of a key or, if unknown, of its value or the enclosing node."""
        written = self.places.get(loc)
        return (written and written.key) or self.place(loc)

    def place(self, loc: Loc) -> Place:
        """Return the place of a value or, if unknown, of the nearest enclosing node."""
        while loc and loc not in self.places:
            loc = loc[:-1]
        return self.places.get(loc) or Place(self.origin)

    def problem_at(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Return a problem at the place of a value."""
        return self.place(loc).problem(loc, message, value)

    def refuse(self, loc: Loc, message: str) -> None:
        """Add the problem of the value at a location, with its text."""
        place = self.place(loc)
        self.problems.append(place.problem(loc, message, place.text))

    def holder(self, loc: Loc) -> Any:
        """Return the mapping or list that holds, or will hold, the value at a location."""
        holder: Any = self.data
        for step in loc[:-1]:
            holder = holder[step]
        return holder

    def put(self, loc: Loc, value: Any, place: Place) -> None:
        """Replace the value at a location, whose holder exists, by one that is given at `place`."""
        self.holder(loc)[loc[-1]] = value
        stale = [inner for inner in self.places if inner[: len(loc)] == loc]
        for inner in stale:
            del self.places[inner]
        self.places[loc] = place

    def take_out(self, loc: Loc) -> None:
        """Take out the value at a location, which is known; its place stays known, for problems."""
        del self.holder(loc)[loc[-1]]


def file_of_spec(folder: Path | None, key: str, name: str) -> Path:
    """Return the path of the file that a key of a spec names, relative to the spec's `folder`;
    SpecError for a relative name without a folder, as in the log of a trial."""
    if folder is None and not Path(name).is_absolute():
        raise SpecError(
            f"{key}: {printable(name)}: is in the folder of a spec that was not read from a file",
            f"name it by its whole path: --set {key}=/PATH; or leave it out: --set {key}=null",
            f'name it by its whole path: "{key}=/PATH"; or leave it out: "{key}=null"',
        )
    return (folder or Path()) / name


SPEC_TEXT = "a spec is YAML text"
"""What `read_text` expects a file to be, unless its caller names something else."""


def read_text(path: Path, max_bytes: int = MAX_BYTES, what: str = SPEC_TEXT) -> str:
    """Read a spec, a file that a spec names, or another file of text.

    Args:
        path: The file.
        max_bytes: Largest size that is read [bytes].
        what: What the file should be, for messages.

    Raises:
        InvalidSpecError: If the file is missing, is too large or cannot be read.
    """

    def refusal(message: str, line: int | None = None, column: int | None = None) -> Exception:
        problem = SpecProblem(printable(str(path)), message, line, column)
        return InvalidSpecError([problem])

    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # reading a FIFO may never end
            raise refusal("is not a regular file")
        with path.open("rb") as stream:
            raw = stream.read(max_bytes + 1)
    except FileNotFoundError:
        raise refusal(f"there is no such file{near_files(path)}") from None
    except IsADirectoryError:
        file = "YAML file" if what == SPEC_TEXT else "file"
        raise refusal(f"is a folder; name a {file} in it") from None
    except OSError as error:
        raise refusal(f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a null character in the name
        raise refusal(f"cannot be read: {error}") from None
    if len(raw) > max_bytes:
        is_spec = what == SPEC_TEXT and max_bytes == MAX_BYTES
        usual = "; a spec is a few kilobytes of YAML" if is_spec else ""
        raise refusal(f"is larger than {max_bytes >> 20} MiB{usual}")
    if b"\0" in raw:
        raise refusal(f"is a binary file; {what}")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line = before.count(b"\n") + 1
        column = error.start - before.rfind(b"\n")
        raise refusal("is not UTF-8 text; save the file as UTF-8", line, column) from None


def read_document(path: Path) -> Document:
    """Read and parse a spec file, or one that a spec names, as `read_text` and `parse_document`."""
    document = parse_document(read_text(path), str(path))
    return replace(document, path=path)


def parse_document(text: str, origin: str) -> Document:
    """Parse a spec's text; raise InvalidSpecError if it is not readable as YAML.

    Errors that leave the rest readable are among the document's `all_problems`.
    """
    document = Document(printable(origin), text=text)
    text = text.removeprefix("\ufeff")
    root = compose(text, document.origin)
    if root is None:
        message = "is empty; a spec starts with 'name:'"
        raise InvalidSpecError([SpecProblem(document.origin, message)])
    builder = _Builder(text, document)
    if not isinstance(root, MappingNode):
        message = "the top level must be a mapping of keys such as 'name:' and 'robots:'"
        raise InvalidSpecError([builder.place(root).problem((), message)])
    data = builder.build(root, ())
    document.data.update(data or {})
    return document


def parse_value(text: str, origin: str, loc: Loc = ()) -> Any:
    """Parse one value, as given to `--set`, for the location `loc`.

    Problems have the printable text `origin` as their location, without a line.
    """
    document = Document(origin)
    value = None
    try:
        root = compose(text, origin)
        if root is not None:
            value = _Builder(text, document).build(root, loc)
    except InvalidSpecError as error:
        document.problems.extend(error.problems)
    if document.all_problems:
        problems = document.all_problems
        raise InvalidSpecError(SpecProblem(p.origin, p.message, field=p.field) for p in problems)
    return value


class _Builder:
    """Turns nodes into plain data, expanding aliases within the limits, and fills a document."""

    def __init__(self, text: str, document: Document) -> None:
        self.text = text
        self.document = document
        self.count = 0

    def build(self, node: Node, loc: Loc, depth: int = 0, key: Place | None = None) -> Any:
        """Return the plain data of a node, and store the place of each value; `key` is that of the
        node's own key."""
        self.count += 1
        within_limits(self.document.origin, depth, self.count, node.start_mark)
        places = self.document.places
        places[loc] = self.place(node, key)
        if isinstance(node, MappingNode) and node.tag == CORE + "map":
            return {
                name: self.build(value, (*loc, name), depth + 1, key_of_value)
                for name, key_of_value, value in self._items(node, loc)
            }
        if isinstance(node, SequenceNode) and node.tag == CORE + "seq":
            return [self.build(child, (*loc, i), depth + 1) for i, child in enumerate(node.value)]
        try:
            if isinstance(node, ScalarNode):
                return scalar(node.tag, node.value)
            raise ValueError(f"the tag {short_tag(node.tag)} does not fit here; leave it out")
        except ValueError as error:
            problem = places[loc].problem(loc, printable(str(error), 200))
            places[loc] = replace(places[loc], refused=problem)
            return None

    def _items(self, node: MappingNode, loc: Loc) -> Iterator[tuple[str, Place, Node]]:
        """Yield each key of a mapping, its place and the node of its value; a later one is asked
        for once the value is built."""
        for key, value in node.value:
            place = self.place(key)
            if not isinstance(key, ScalarNode) or key.tag != STR:
                said = "a key must be text, or in quotes"
                if (place.text or "").isdecimal():
                    said += "; a decimal number has a point, not a comma"
                problem = place.problem(loc, said, place.text)
                self.document.problems.append(problem)
            elif (*loc, key.value) in self.document.places:
                first = self.document.key((*loc, key.value)).line
                message = f"is given twice, first in line {first}; keep one"
                self.document.problems.append(place.problem((*loc, key.value), message))
            else:
                yield key.value, place, value

    def place(self, node: Node, key: Place | None = None) -> Place:
        """Return the place of a node with this key, with its text if that is on a single line."""
        start = node.start_mark
        text = self.text[start.index : node.end_mark.index].strip()
        one_line = "\n" not in text and not isinstance(node, MappingNode)
        excerpt = printable(text, SHOWN_LENGTH) if one_line and text else None
        return Place(self.document.origin, start.line + 1, start.column + 1, excerpt, key)


# ---- values that are put into a document ----


@dataclass(frozen=True, slots=True)
class FieldValue:
    """The value that an option such as `--seed 3` states for the field at a path, such as
    `trials.seed`; problems with the value name the option.
    """

    path: str
    value: Any
    option: str

    @property
    def origin(self) -> str:
        """The option and its value, as typed."""
        return f"{self.option} {self.value}"


SpecSetting = str | FieldValue
"""A value of one field: `PATH=VALUE`, with a value in YAML, or a `FieldValue`."""


def with_settings(document: Document, settings: Sequence[SpecSetting]) -> Document:
    """Return a copy of a document with settings; errors are added to the copy's problems.

    A step of a setting's path is a key, an index, or the `name` of an entry: `robots.0.a`,
    `robots.green.a`. Mappings that the spec omits are created.
    """
    changed = replace(
        document,
        data=deepcopy(document.data),
        places=dict(document.places),
        problems=list(document.problems),
    )
    for setting in settings:
        try:
            if isinstance(setting, str):
                _put_text(changed, setting)
            else:
                place = Place(setting.origin, text=str(setting.value))
                loc = make_way(changed, setting.path.split("."), place)
                changed.put(loc, setting.value, place)
        except InvalidSpecError as error:
            changed.problems.extend(error.problems)
    return changed


def _put_text(document: Document, setting: str) -> None:
    """Put the value of a setting such as `robots.0.a=6`, which is YAML, in its place."""
    place = Place(f"--set {printable(setting, 200)}")
    path, equals, text = setting.partition("=")
    path = path.strip()
    if not (equals and path):
        message = "must be PATH=VALUE, for instance controller.optimizer.particles=200"
        raise InvalidSpecError([place.problem((), message)])
    steps = path.split(".")
    if len(steps) > MAX_DEPTH:
        raise InvalidSpecError([place.problem((), f"the path has more than {MAX_DEPTH} steps")])
    loc = make_way(document, steps, place)
    value = parse_value(text, place.origin, loc)
    document.put(loc, value, replace(place, text=printable(text, 60) or None))


def make_way(document: Document, steps: Sequence[str], place: Place) -> Loc:
    """Return the location that a path means, after creating the mappings on the way to it.

    A step is a key, the `name` of a list's entry, or an index. InvalidSpecError, at the `place`
    where the path is given, if there is none.
    """
    loc: Loc = ()
    holder: Any = document.data
    for step in steps[:-1]:
        loc = (*loc, _key(holder, loc, step, place))
        if isinstance(holder, dict) and holder.get(step) is None:
            document.put(loc, {}, replace(place, text=None))
        holder = holder[loc[-1]]
    return (*loc, _key(holder, loc, steps[-1], place))


def _key(holder: Any, loc: Loc, step: str, place: Place) -> str | int:
    """Return the key or index that a step of a path means in `holder`, the value at `loc`."""
    if isinstance(holder, list):
        return _index(holder, loc, step, place)
    if not isinstance(holder, dict):
        message = f"has no '{printable(step, 60)}'; it is a single value"
        raise InvalidSpecError([place.problem(loc, message)])
    if not step:
        raise InvalidSpecError([place.problem(loc, "a step of the path is empty")])
    return step


def _index(entries: list[Any], loc: Loc, step: str, place: Place) -> int:
    """Return the index of the list's entry that a step means: by index, or by its name."""
    names = {
        i: str(entry["name"])
        for i, entry in enumerate(entries)
        if isinstance(entry, dict) and "name" in entry
    }
    for i in range(len(entries)):
        if step in (str(i), names.get(i)):
            return i
    choices = "none: it is empty"
    if entries:
        choices = f"0 to {len(entries) - 1}"
    if names:
        choices += f" or {', '.join(names.values())}"
    message = f"has no entry '{printable(step, 60)}'; its entries are {choices}"
    raise InvalidSpecError([place.problem(loc, message)])
