"""The runner of the documentation's examples (docs/console.py)."""

import pytest
from support.pages import console


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("", "whatever"),
        ("wrote a.png\n", "wrote a.png\n"),
        ("a  b\n────\n", "a b\n──────────\n\n"),
        ("mean 100.0 mm\n", "mean 114.9 mm\n"),
        ("red 0.003\n", "red 0.006\n"),
        ("solve time ... ms, 3 of 4\n", "solve time 17.4 ms, 3 of 4\n"),
        ("first\n...\nlast\n", "first\nx\ny\nlast\n"),
        ("first\n...\nlast\n", "first\nlast\n"),
        ("first\n...\n", "first\n"),
        ("(a) [b] $HOME \\d\n", "(a) [b] $HOME \\d\n"),
        ("J 1e-05\n", "J 1.01e-05\n"),
    ],
)
def test_what_agrees(shown, printed):
    assert console.agrees(shown, printed)


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("wrote a.png\n", "wrote b.png\n"),
        ("mean 100.0 mm\n", "mean 115.1 mm\n"),
        ("entered 0 of 20\n", "entered 1 of 20\n"),
        ("2\n", "0\n"),
        ("one\n", "one\ntwo\n"),
        ("one\ntwo\n", "one\n"),
        ("first\n...\nlast\n", "first\nx\n"),
        ("wrote\n", ""),
    ],
)
def test_what_does_not(shown, printed):
    assert not console.agrees(shown, printed)


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
    assert console.mended(PAGE.format("wrong")) == PAGE.format("one")
    assert console.mended(PAGE.format("o...")) == PAGE.format("o...")
