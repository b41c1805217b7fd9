"""A parsed spec: plain data, and the place in the file from which each value comes.

A location is a tuple of keys and list indices, such as ("robots", 0, "a"). A value may also come
from `--set`, from another option, or from a file that the spec refers to. Problems with such a
value name that option or file.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from tetractl.core.errors import printable
from tetractl.spec.yaml.core_yaml import (
    CORE,
    STR,
    convert_scalar,
    parse_nodes,
    require_within_limits,
    shorten_tag,
)
from tetractl.spec.yaml.problems import (
    SHOWN_LENGTH,
    InvalidSpecError,
    Loc,
    SpecProblem,
    format_loc,
)
from tetractl.spec.yaml.spec_files import read_text


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a value or a key in a file, with its text.

    Attributes:
        origin: Name of the file, or the option that gives the value.
        line: The line, from 1. None if unknown.
        column: The column, from 1. None if unknown.
        text: The value or key as written. None if unknown.
        key: Place of the key of a value in a mapping. None for other values.
        refused: The problem of a value that YAML's core schema does not allow. The data contains
            None instead of the value. None if the value is allowed.
    """

    origin: str
    line: int | None = None
    column: int | None = None
    text: str | None = None
    key: "Place | None" = None
    refused: SpecProblem | None = None

    def problem(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Create a problem that is reported at this place of the file.

        Args:
            loc: The location of the value.
            message: What is wrong.
            value: The value as text. None to leave it out.
        """
        return SpecProblem(self.origin, message, self.line, self.column, format_loc(loc), value)


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed spec, with the place of every value and the problems that were found so far.

    Attributes:
        origin: Name of the file, for messages.
        data: The spec's data: mappings, lists and single values.
        places: The place of each value, by location.
        problems: The problems so far, except refused values.
        text: The spec as written.
        path: The spec's file. None if the text comes from no file.
    """

    origin: str
    data: dict[str, Any] = field(default_factory=dict)
    places: dict[Loc, Place] = field(default_factory=dict)
    problems: list[SpecProblem] = field(default_factory=list)
    text: str = field(default="", repr=False)
    path: Path | None = None

    @property
    def all_problems(self) -> list[SpecProblem]:
        """All problems of the document so far, including values that were refused.

        Refused values come last.
        """
        refused = [place.refused for place in self.places.values() if place.refused]
        return [*self.problems, *refused]

    def require_no_problems(self) -> None:
        """Raise InvalidSpecError with the problems so far, if there are any."""
        if self.all_problems:
            raise InvalidSpecError(self.all_problems)

    def key(self, loc: Loc) -> Place:
        """Return the place of a key.

        If unknown, return the place of its value or enclosing node.
        """
        place = self.places.get(loc)
        return (place and place.key) or self.place(loc)

    def place(self, loc: Loc) -> Place:
        """Return the place of a value.

        If unknown, return the place of the nearest enclosing node.
        """
        while loc and loc not in self.places:
            loc = loc[:-1]
        return self.places.get(loc) or Place(self.origin)

    def problem_at(self, loc: Loc, message: str, value: str | None = None) -> SpecProblem:
        """Create a problem that is reported at the place of a value.

        Args:
            loc: The location of the value.
            message: What is wrong.
            value: The value as text. None to leave it out.
        """
        return self.place(loc).problem(loc, message, value)

    def refuse(self, loc: Loc, message: str) -> None:
        """Add a problem about the value at a location to `problems`. Nothing is raised."""
        place = self.place(loc)
        self.problems.append(place.problem(loc, message, place.text))

    def holder(self, loc: Loc) -> Any:
        """Return the mapping or list that contains, or will contain, the value at a location.

        This mapping or list must exist.
        """
        holder: Any = self.data
        for step in loc[:-1]:
            holder = holder[step]
        return holder

    def put(self, loc: Loc, value: Any, place: Place) -> None:
        """Replace the value at a location by a value from another source.

        Args:
            loc: The location. The mapping or list that contains it must exist.
            value: The new value.
            place: The place from which the new value comes.
        """
        self.holder(loc)[loc[-1]] = value
        outdated_locs = [inner_loc for inner_loc in self.places if inner_loc[: len(loc)] == loc]
        for inner_loc in outdated_locs:
            del self.places[inner_loc]
        self.places[loc] = place

    def remove(self, loc: Loc) -> None:
        """Remove the value at a location, but remember its place for problems.

        The value must exist.
        """
        del self.holder(loc)[loc[-1]]


def read_document(path: Path) -> Document:
    """Read and parse a spec file, or a file that a spec names.

    Problems of single values are kept in the document's `all_problems`.

    Raises:
        InvalidSpecError: If the file cannot be read, or is not a mapping in YAML.
    """
    document = parse_document(read_text(path), str(path))
    return replace(document, path=path)


def parse_document(text: str, origin: str) -> Document:
    """Parse the text of a spec.

    Errors that leave the rest of the text readable become part of the document's `all_problems`.

    Raises:
        InvalidSpecError: If the text cannot be read as YAML.
    """
    document = Document(printable(origin), text=text)
    text = text.removeprefix("\ufeff")
    root = parse_nodes(text, document.origin)
    if root is None:
        message = "is empty, but a spec starts with 'name:'"
        raise InvalidSpecError([SpecProblem(document.origin, message)])
    builder = _Builder(text, document)
    if not isinstance(root, MappingNode):
        message = "the top level must be a mapping of keys such as 'name:' and 'robots:'"
        raise InvalidSpecError([builder.place(root).problem((), message)])
    data = builder.build(root, ())
    document.data.update(data or {})
    return document


def parse_value(text: str, origin: str, loc: Loc = ()) -> Any:
    """Convert the text of one value, such as the value of `--set`, by the rules of YAML.

    Args:
        text: The value.
        origin: A printable text that problems name as their place, without a line.
        loc: The location of the value.
    """
    document = Document(origin)
    value = None
    try:
        root = parse_nodes(text, origin)
        if root is not None:
            value = _Builder(text, document).build(root, loc)
    except InvalidSpecError as error:
        document.problems.extend(error.problems)
    if document.all_problems:
        problems = document.all_problems
        raise InvalidSpecError(
            SpecProblem(problem.origin, problem.message, field=problem.field)
            for problem in problems
        )
    return value


class _Builder:
    """A converter of YAML nodes to plain data, which it stores in a document."""

    def __init__(self, text: str, document: Document) -> None:
        self.text = text
        self.document = document
        self.count = 0

    def build(self, node: Node, loc: Loc, depth: int = 0, key: Place | None = None) -> Any:
        """Return the plain data of a node, and store the place of each value.

        Args:
            node: The node.
            loc: Its location.
            depth: Depth of nesting.
            key: Place of the node's own key. None if it has none.
        """
        self.count += 1
        require_within_limits(self.document.origin, depth, self.count, node.start_mark)
        places = self.document.places
        places[loc] = self.place(node, key)
        if isinstance(node, MappingNode) and node.tag == CORE + "map":
            return {
                name: self.build(value, (*loc, name), depth + 1, key_of_value)
                for name, key_of_value, value in self._read_items(node, loc)
            }
        if isinstance(node, SequenceNode) and node.tag == CORE + "seq":
            return [self.build(child, (*loc, i), depth + 1) for i, child in enumerate(node.value)]
        try:
            if isinstance(node, ScalarNode):
                return convert_scalar(node.tag, node.value)
            raise ValueError(f"the tag {shorten_tag(node.tag)} does not fit here; leave it out")
        except ValueError as error:
            problem = places[loc].problem(loc, printable(str(error), 200))
            places[loc] = replace(places[loc], refused=problem)
            return None

    def _read_items(self, node: MappingNode, loc: Loc) -> Iterator[tuple[str, Place, Node]]:
        """Yield each key of a mapping, its place and the node of its value.

        A key that is not text, or that occurs a second time, is left out and added to the problems.
        The next key is requested after the value is built.
        """
        for key, value in node.value:
            place = self.place(key)
            if not isinstance(key, ScalarNode) or key.tag != STR:
                said = "a key must be text, or in quotes"
                if (place.text or "").isdecimal():
                    said += "; a decimal number has a point, not a comma"
                problem = place.problem(loc, said, place.text)
                self.document.problems.append(problem)
            elif (*loc, key.value) in self.document.places:
                first_line = self.document.key((*loc, key.value)).line
                message = f"is given twice, first in line {first_line}; keep one"
                self.document.problems.append(place.problem((*loc, key.value), message))
            else:
                yield key.value, place, value

    def place(self, node: Node, key: Place | None = None) -> Place:
        """Return the place of a node with this key, with line and column counted from 1.

        It includes the node's text if that is on a single line and the node is not a mapping.
        """
        start_mark = node.start_mark
        excerpt_text = self.text[start_mark.index : node.end_mark.index].strip()
        one_line = "\n" not in excerpt_text and not isinstance(node, MappingNode)
        excerpt = printable(excerpt_text, SHOWN_LENGTH) if one_line and excerpt_text else None
        return Place(self.document.origin, start_mark.line + 1, start_mark.column + 1, excerpt, key)
