"""Tests of the runner of the documentation's examples (docs/console.py)."""

import console
import pytest


@pytest.mark.parametrize(
    ("on_page", "printed"),
    [
        ("", "whatever"),
        ("wrote a.png\n", "wrote a.png\n"),
        ("a  b\n────\n", "a b\n──────────\n\n"),
        ("solve time ... ms, 3 of 4\n", "solve time 17.4 ms, 3 of 4\n"),
        ("first\n...\nlast\n", "first\nx\ny\nlast\n"),
        ("first\n...\nlast\n", "first\nlast\n"),
        ("first\n...\n", "first\n"),
        ("(a) [b] $HOME \\d\n", "(a) [b] $HOME \\d\n"),
    ],
)
def test_what_agrees(on_page, printed):
    assert console.agrees(on_page, printed, exact=True)


@pytest.mark.parametrize(
    ("on_page", "printed"),
    [
        ("wrote a.png\n", "wrote b.png\n"),
        ("entered 0 of 20\n", "entered 1 of 20\n"),
        ("2\n", "0\n"),
        ("one\n", "one\ntwo\n"),
        ("one\ntwo\n", "one\n"),
        ("first\n...\nlast\n", "first\nx\n"),
        ("wrote\n", ""),
    ],
)
def test_what_does_not(on_page, printed):
    assert not console.agrees(on_page, printed, exact=True)


NOTE = "\n<!-- numbers printed on {} -->\n"
PAGE = """Make a file:

```text title=note.txt
one
two
```

```console
$ cat note.txt | \\
    head -1
{}
$ false
$ echo $?
1
```

```sh
rm -rf /nothing/of/this/is/run
```
"""


def test_a_page_is_run_in_one_folder():
    cat, false, echo = console.run(PAGE.format("one"))
    example, printed, _ = cat
    assert example.command == "cat note.txt | \\\n    head -1"
    assert printed == "one\n"
    _, _, exit_code = false
    assert exit_code == 1
    _, printed, _ = echo
    assert printed == "1\n"


def test_a_page_with_another_output_is_mended_and_says_where():
    mended = console.mended(PAGE.format("wrong"))
    assert mended == PAGE.format("one") + NOTE.format(console.here())
    assert console.printed_on(mended) == console.here()
    assert console.mended(mended) == mended


@pytest.mark.parametrize(
    ("on_page", "printed", "mended"),
    [
        ("...\n total 1.5\n...\n", "start\n total  2.5\nlogs in x\n", "...\n total  2.5\n...\n"),
        ("first\n...\nlast 1\n", "first\nlast 2\nx\nlast 3\n", "first\n...\nlast 3\n"),
        ("first\n...\n", "first\nx\n", "first\n...\n"),
        ("...\nmiddle\n...\n", "other words\n", "other words\n"),
        ("it took ... s, 3 of 4\n", "it took 17.4 s, 4 of 4\n", "it took ... s, 4 of 4\n"),
    ],
)
def test_a_mended_output_leaves_out_what_the_page_left_out(on_page, printed, mended):
    assert console._with_dots(on_page.splitlines(), printed) == mended


WORDS = "trial of: sequence completed, total error mm, steps"


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        (WORDS, True),
        ("trial 1 of 20: sequence completed, total error 14.5 mm, 61 steps, 12.2 s", True),
        (f"other {WORDS} words between", True),
        ("trial of: no better plan, total error mm, steps", False),
        ("error: no such file", False),
    ],
)
def test_of_numbers_printed_elsewhere_only_the_words_are_compared(printed, same):
    assert console.agrees(WORDS, printed, exact=False) is same


@pytest.mark.parametrize("note", ["", NOTE.format(console.here())])
def test_a_page_that_agrees_stays_as_it_is(note):
    page = PAGE.format("o...") + note
    assert console.mended(page) == page
