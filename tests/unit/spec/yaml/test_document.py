import pytest

from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.spec.yaml.spec_files import MAX_BYTES, read_text

pytestmark = pytest.mark.slow

TEXT = """\
name: x
robots:
  - {name: one, start: [900, 800]}
  - name: two
    start:
      - 1.5
      - "2"
note: >
  folded
  text
"""


def place(document, *loc):
    """The line, column and text of a value, None if it is a list, a mapping or a block."""
    value = document.places[loc]
    return value.line, value.column, value.text


def test_every_value_has_its_place_and_text():
    document = parse_document(TEXT, "s.yaml")
    assert document.data["robots"][1] == {"name": "two", "start": [1.5, "2"]}
    assert place(document, "name") == (1, 7, "x")
    assert place(document, "robots", 0, "start") == (3, 24, "[900, 800]")
    assert place(document, "robots", 0, "start", 1) == (3, 30, "800")
    assert place(document, "robots", 1) == (4, 5, None)
    assert place(document, "robots", 1, "start", 1) == (7, 9, '"2"')
    assert place(document, "note") == (8, 7, None)
    assert document.key(("robots", 0, "start")).column == 17


def test_a_byte_order_mark_and_windows_line_ends_do_not_shift_places():
    document = parse_document("\ufeff" + TEXT.replace("\n", "\r\n"), "s.yaml")
    assert place(document, "robots", 0, "start") == (3, 24, "[900, 800]")


def lines(text):
    document = parse_document(text, "s.yaml")
    return [str(problem) for problem in document.all_problems]


def test_duplicate_keys_are_reported_with_both_lines():
    assert lines("a: 1\nb: {c: 1, c: 2}\na: 3\n") == [
        "s.yaml:2:11: b.c: is given twice, first in line 2; keep one",
        "s.yaml:3:1: a: is given twice, first in line 1; keep one",
    ]


@pytest.mark.parametrize("key", ["1", "true", "~", "[a]", "{a: b}", "1.5"])
def test_keys_are_text(key):
    (line,) = lines(f"a: 1\n{key}: 2\n")
    assert line.startswith("s.yaml:2:")
    assert "a key must be text" in line


TAGS = (
    "!!python/object/apply:os.system [ls]", "!!binary aGVsbG8=", "!!timestamp 2020-01-01",
    "!!set {a, b}", "!mine 5", "!!int five", "!!seq text", "!!map [1]", "!!omap [a: 1]",
)  # fmt: skip


@pytest.mark.parametrize("value", TAGS)
def test_tags_that_are_not_core_or_do_not_fit_are_refused(value):
    (line,) = lines(f"a: {value}\n")
    assert line.startswith("s.yaml:1:4: a: the tag !")


def bomb(levels):
    rungs = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join(["a0: &a0 [x, x]", *rungs])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("# only this\n", "is empty"),
        ("- a\n- b\n", "s.yaml:1:1: the top level must be a mapping"),
        ("hello", "s.yaml:1:1: the top level must be a mapping"),
        ("!!set {a: null}", "s.yaml:1:1: the tag !!set does not fit"),
        (bomb(9), "more than 100000 values (each use of an alias counts)"),
        ("a: &a [*a]", "nested deeper than 32 levels"),
        ("a: &a {b: *a}", "nested deeper than 32 levels"),
    ],
)
def test_texts_that_are_no_spec_at_all(text, words):
    with pytest.raises(InvalidSpecError) as caught:
        document = parse_document(text, "s.yaml")
        raise InvalidSpecError(document.all_problems)
    assert words in str(caught.value)
    assert len(caught.value.message.splitlines()) == 1


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"name: \xff\n", ":1:7: is not UTF-8 text"),
        (b"a: 1\nb: caf\xe9", ":2:7: is not UTF-8 text"),
        (b"\x7fELF\0\0", "is a binary file"),
        ("name: x".encode("utf-16"), "is a binary file"),
        (b"#" * (MAX_BYTES + 1), "is larger than 1 MiB"),
    ],
)
def test_files_that_are_no_text(tmp_path, raw, words):
    path = tmp_path / "s.yaml"
    path.write_bytes(raw)
    with pytest.raises(InvalidSpecError) as caught:
        read_text(path)
    assert words in str(caught.value)
