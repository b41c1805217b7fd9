"""Read and write YAML by the core schema of YAML 1.2, with PyYAML.

PyYAML follows YAML 1.1, where `on` is true, 12:30 is 750, 1e3 is text, and 2020-01-01 is a date.
This module applies only the core schema, and accepts only one document of limited depth and size.
"""

import re
from typing import Any, ClassVar

import yaml
from yaml.error import Mark, MarkedYAMLError
from yaml.events import StreamEndEvent
from yaml.nodes import Node, ScalarNode
from yaml.reader import ReaderError

from tetractl.core.errors import printable
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem

MAX_DEPTH = 32
MAX_NODES = 100_000
MAX_DIGITS = 300

CORE = "tag:yaml.org,2002:"
STR = CORE + "str"
# the patterns of YAML 1.2.2, section 10.3.2, each with the first characters that PyYAML looks up
SCALARS = {
    CORE + "null": (r"(?:~|null|Null|NULL|)\Z", ["~", "n", "N", ""]),
    CORE + "bool": (r"(?:true|True|TRUE|false|False|FALSE)\Z", list("tTfF")),
    CORE + "int": (r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)\Z", list("-+0123456789")),
    CORE + "float": (
        r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z",
        list("-+.0123456789"),
    ),
}


def create_yaml_error(origin: str, message: str, mark: Mark | None) -> InvalidSpecError:
    """Create the error for text that is not one YAML document within the limits.

    Args:
        origin: Name of the file.
        message: What is wrong.
        mark: The position in the text. None if it is unknown.
    """
    line, column = (None, None) if mark is None else (mark.line + 1, mark.column + 1)
    return InvalidSpecError([SpecProblem(origin, printable(message, 300), line, column)])


def require_within_limits(origin: str, depth: int, nodes: int, mark: Mark) -> None:
    """Check that the values of a YAML file are not nested too deeply, and are not too many.

    Args:
        origin: Name of the file.
        depth: Depth of nesting.
        nodes: Number of values so far.
        mark: Position of the value in the text.

    Raises:
        InvalidSpecError: If a limit is exceeded.
    """
    if depth > MAX_DEPTH:
        raise create_yaml_error(
            origin, f"the values are nested deeper than {MAX_DEPTH} levels", mark
        )
    if nodes > MAX_NODES:
        text = f"the file has more than {MAX_NODES} values (each use of an alias counts)"
        raise create_yaml_error(origin, text, mark)


class _Composer(yaml.SafeLoader):
    yaml_implicit_resolvers: ClassVar = {}

    def __init__(self, text: str, origin: str) -> None:
        super().__init__(text)
        self.origin = origin
        self.depth = 0
        self.nodes = 0

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        self.depth += 1
        self.nodes += 1
        require_within_limits(self.origin, self.depth, self.nodes, self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    """A YAML writer that quotes text which would otherwise be read as another type."""

    def represent_text(self, text: str) -> ScalarNode:
        # only in double quotes does PyYAML keep every control character and line break
        return self.represent_scalar(STR, text, style=None if text.isprintable() else '"')


_Dumper.add_representer(str, _Dumper.represent_text)

for _tag, (_pattern, _first) in SCALARS.items():
    for _resolver in (_Composer, _Dumper):
        _resolver.add_implicit_resolver(_tag, re.compile(_pattern), _first)


def parse_nodes(text: str, origin: str) -> Node | None:
    """Parse a text to a graph of YAML nodes, and return the root. None if the text is empty.

    Raises:
        InvalidSpecError: If the text is not YAML, or contains more than one document.
    """
    try:
        composer = _Composer(text, origin)
        composer.get_event()  # the stream's start
        if composer.check_event(StreamEndEvent):
            return None
        root = composer.compose_document()
        if not composer.check_event(StreamEndEvent):
            mark = composer.peek_event().start_mark
            raise create_yaml_error(
                origin, "a second document starts here, but a spec is a single document", mark
            )
    except ReaderError as error:
        text_before = text[: error.position]
        column = len(text_before) - text_before.rfind("\n") - 1
        mark = _create_mark(text_before.count("\n"), column)
        message = f"not valid YAML: the character U+{error.character:04X} is not allowed"
        raise create_yaml_error(origin, message, mark) from None
    except MarkedYAMLError as error:
        if error.problem_mark is not None:
            _refuse_missing_space(text, origin, error.problem_mark.line)
        context = f" ({error.context})" if error.context else ""
        tab_hint = "; indent with spaces, not tabs" if "'\\t'" in (error.problem or "") else ""
        message = f"not valid YAML: {error.problem}{context}{tab_hint}"
        raise create_yaml_error(origin, message, error.problem_mark or error.context_mark) from None
    is_empty = isinstance(root, ScalarNode) and root.start_mark.index == root.end_mark.index
    return None if is_empty else root


def _create_mark(line: int, column: int) -> Mark:
    """Create a position in a text. Line and column are counted from 0."""
    return Mark("", 0, line, column, None, 0)


def _refuse_missing_space(text: str, origin: str, line: int) -> None:
    """Check that the line above `line`, from 0, has a space after its colon.

    Without it, YAML reads the line as the beginning of a text, and refuses the next line.

    Raises:
        InvalidSpecError: If the space is missing.
    """
    lines_above = text.splitlines()[max(line - 1, 0) : line]
    key_and_value = lines_above[0].partition(" #")[0] if lines_above else ""
    hint = suggest_space(key_and_value.strip())
    if hint:
        indent = len(key_and_value) - len(key_and_value.lstrip())
        mark = _create_mark(line - 1, indent)
        raise create_yaml_error(origin, f"not valid YAML: {hint}", mark) from None


def suggest_space(text: str) -> str:
    """Suggest a missing space after the colon of a key, as in "speed:3". Empty for other texts.

    YAML reads such a key and its value as one text.
    """
    match = re.fullmatch(r"([A-Za-z_]\w*):([^\s/:].*)", text)
    return f"a space is missing after the colon: {match[1]}: {match[2]}" if match else ""


def convert_scalar(tag: str, text: str) -> str | bool | int | float | None:
    """Convert the text of a YAML scalar to a value, according to its tag.

    Raises:
        ValueError: If the text does not fit the tag. The message gives the reason.
    """
    if tag == STR:
        return text
    if tag not in SCALARS or not re.match(SCALARS[tag][0], text):
        raise ValueError(f"the tag {shorten_tag(tag)} does not fit here; leave it out")
    if len(text) > MAX_DIGITS:
        raise ValueError(f"a number can have at most {MAX_DIGITS} digits")
    match tag.removeprefix(CORE):
        case "null":
            return None
        case "bool":
            return text.lower() == "true"
        case "int":
            base = {"0o": 8, "0x": 16}.get(text[:2])
            return int(text[2:], base) if base else int(text)
    python_literal = text.lower().replace(".inf", "inf").replace(".nan", "nan")
    number = float(python_literal)
    # 1e3 and 100.0 are whole numbers in JSON, in the schema and for readers
    return int(number) if number.is_integer() and abs(number) < 2**53 else number


def shorten_tag(tag: str) -> str:
    """Return the short form of a YAML core tag, such as `!!map`. Other tags stay the same."""
    return tag.replace(CORE, "!!")


def format_yaml(data: Any) -> str:
    """Convert plain data to YAML text: one key per line, points as [x, y].

    Keys keep their order.
    """
    return yaml.dump(
        data,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=100,
    )
