"""A spec's text as plain data, with the location of each value in the text."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from tetractl.core.errors import SpecError, printable
from tetractl.experiment.yaml.core_yaml import CORE, STR, compose, scalar, short_tag, within_limits
from tetractl.experiment.yaml.problems import (
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
    """The file, line and column (from 1) of a value or a key, and the text of that value or key."""

    origin: str
    line: int | None = None
    column: int | None = None
    text: str | None = None

    def problem(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Return a problem at this location."""
        return SpecProblem(self.origin, message, self.line, self.column, dotted(loc), value)


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed spec: data, the location of every value and key, and problems.

    `refused` holds the errors of refused values, which are None in `data`. `text` is the spec as
    written, and `path` its file, None for a text that comes from no file.
    """

    origin: str
    data: dict[str, Any] = field(default_factory=dict)
    values: dict[Loc, Place] = field(default_factory=dict)
    keys: dict[Loc, Place] = field(default_factory=dict)
    problems: list[SpecProblem] = field(default_factory=list)
    refused: dict[Loc, SpecProblem] = field(default_factory=dict)
    text: str = field(default="", repr=False)
    path: Path | None = None

    @property
    def all_problems(self) -> list[SpecProblem]:
        """The document's problems so far, including refused values."""
        return [*self.problems, *self.refused.values()]

    def key(self, loc: Loc) -> Place:
        """Return the location of a key or, if unknown, of its value or the enclosing node."""
        return self.keys.get(loc) or self.place(loc)

    def place(self, loc: Loc) -> Place:
        """Return the location of a value or, if unknown, of the nearest enclosing node."""
        while loc and loc not in self.values:
            loc = loc[:-1]
        return self.values.get(loc) or Place(self.origin)

    def problem_at(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Return a problem at the location of a value."""
        return self.place(loc).problem(loc, message, value)


def file_of_spec(folder: Path | None, key: str, name: str) -> Path:
    """Return the path of the file that a key of a spec names, relative to the spec's `folder`;
    SpecError for a relative name without a folder, as in the log of a trial."""
    if folder is None and not Path(name).is_absolute():
        raise SpecError(
            f"{key}: {printable(name)}: is in the folder of a spec that was not read from a file",
            f"name it by its whole path: --set {key}=/PATH; or leave it out: --set {key}=null",
        )
    return (folder or Path()) / name


def read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """Read a spec file, or one that a spec names; InvalidSpecError if it is missing, is larger than
    `max_bytes` or cannot be read."""

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
        raise refusal("is a folder; name a YAML file in it") from None
    except OSError as error:
        raise refusal(f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a null character in the name
        raise refusal(f"cannot be read: {error}") from None
    if len(raw) > max_bytes:
        usual = "; a spec is a few kilobytes of YAML" if max_bytes == MAX_BYTES else ""
        raise refusal(f"is larger than {max_bytes >> 20} MiB{usual}")
    if b"\0" in raw:
        raise refusal("is a binary file; a spec is YAML text")
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

    Errors that leave the rest readable are in the document's `problems` and `refused`.
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
    data = builder.build(root, (), 0)
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
            value = _Builder(text, document).build(root, loc, 0)
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

    def build(self, node: Node, loc: Loc, depth: int) -> Any:
        """Return the plain data of a node, and store the location of each value."""
        self.count += 1
        within_limits(self.document.origin, depth, self.count, node.start_mark)
        self.document.values[loc] = self.place(node)
        if isinstance(node, MappingNode) and node.tag == CORE + "map":
            items = self._items(node, loc)
            return {key: self.build(value, (*loc, key), depth + 1) for key, value in items}
        if isinstance(node, SequenceNode) and node.tag == CORE + "seq":
            return [self.build(child, (*loc, i), depth + 1) for i, child in enumerate(node.value)]
        try:
            if isinstance(node, ScalarNode):
                return scalar(node.tag, node.value)
            raise ValueError(f"the tag {short_tag(node.tag)} does not fit here; leave it out")
        except ValueError as error:
            problem = self.document.values[loc].problem(loc, printable(str(error), 200))
            self.document.refused[loc] = problem
            return None

    def _items(self, node: MappingNode, loc: Loc) -> Iterator[tuple[str, Node]]:
        keys = self.document.keys
        for key, value in node.value:
            place = self.place(key)
            if not isinstance(key, ScalarNode) or key.tag != STR:
                said = "a key must be text, or in quotes"
                if (place.text or "").isdecimal():
                    said += "; a decimal number has a point, not a comma"
                problem = place.problem(loc, said, place.text)
                self.document.problems.append(problem)
            elif (*loc, key.value) in keys:
                first = keys[*loc, key.value].line
                message = f"is given twice, first in line {first}; keep one"
                self.document.problems.append(place.problem((*loc, key.value), message))
            else:
                keys[*loc, key.value] = place
                yield key.value, value

    def place(self, node: Node) -> Place:
        """Return the location of a node, with its text if that is on a single line."""
        start = node.start_mark
        text = self.text[start.index : node.end_mark.index].strip()
        one_line = "\n" not in text and not isinstance(node, MappingNode)
        excerpt = printable(text, SHOWN_LENGTH) if one_line and text else None
        return Place(self.document.origin, start.line + 1, start.column + 1, excerpt)
