"""The runner of the documentation's examples (docs/console.py)."""

import console
import pytest


@pytest.mark.parametrize(
    ("shown", "printed"),
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
def test_what_agrees(shown, printed):
    assert console.agrees(shown, printed, exact=True)


@pytest.mark.parametrize(
    ("shown", "printed"),
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
def test_what_does_not(shown, printed):
    assert not console.agrees(shown, printed, exact=True)


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


def test_a_page_is_run_in_one_folder_and_mended():
    (cat, printed, _), (_, _, failed), (_, one, _) = console.run(PAGE.format("one"))
    assert (cat.command, printed, failed, one) == (
        "cat note.txt | \\\n    head -1",
        "one\n",
        1,
        "1\n",
    )
    mended = console.mended(PAGE.format("wrong"))
    assert mended == PAGE.format("one") + NOTE.format(console.here())
    assert console.printed_on(mended) == console.here()
    assert console.mended(mended) == mended
    dotted = PAGE.format("o...")
    for page in (dotted, dotted + NOTE.format(console.here())):
        assert console.mended(page) == page


def test_what_a_page_leaves_out_stays_left_out():
    page = """```console
$ printf 'trial %s took 5 ms\\n' 1 2 3 4; printf 'mean 7\\nnew 1\\nsolve time  17.4 ms, 3 of 4\\n'
trial 1 took ... ms
...
trial 4 took ... ms
mean 8
solve time ... ms, 2 of 4
```
"""
    shown = console.mended(page).splitlines()[2:-3]
    assert shown == [
        "trial 1 took ... ms",
        "...",
        "trial 4 took ... ms",
        "mean 7",
        "new 1",
        "solve time  ... ms, 3 of 4",
    ]
