"""Find words that readers stumble over, in the texts of the code and in the pages.

Run `python docs/words.py`. It prints each place as file:line, and exits with 1 if there is one. In
Python files it reads docstrings, comments and every string with a space (help, errors, labels). In
Markdown pages and YAML files it reads everything except code. The second column of `WORDS` says
what to write instead.
"""

import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
TREES = ("tetractl", "tests", "benchmarks", "docs", "examples", "experiments", "packages", ".")
WORDS = {
    r"told": "configured, reported, commanded; told apart: distinguished",
    r"believ\w+|beliefs?": "accept, trust, assume, infer",
    r"anew": "again, regenerated",
    r"to the letter": "exactly as published",
    r"of old|of older code": "legacy, outdated",
}
_CHECKS = [
    (re.compile(rf"(?<![\w-])(?:{word})(?![\w-])", re.IGNORECASE), say)
    for word, say in WORDS.items()
]
_CODE = re.compile(r"^```.*?^```$|`[^`\n]*`|\]\([^)]*\)", re.DOTALL | re.MULTILINE)


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line number and the words of each text of a file that people read."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            prose = token.type == tokenize.STRING and " " in token.string
            if prose or token.type in (tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1)):
                yield token.start[0], re.sub(r"`[^`\n]*`|\{[^{}\n]*\}", "", token.string)
    else:
        blank = _CODE.sub(lambda code: re.sub(r"[^\n]", " ", code[0]), source)
        yield from enumerate(blank.splitlines(), 1)


def places(root: Path) -> Iterator[str]:
    """Yield a line for each word of the list that stands in a text below `root`."""
    for path in sorted(root.rglob("*")):
        if path.suffix not in (".py", ".md", ".yaml") or any(
            p.startswith((".", "logs")) for p in path.relative_to(root).parts
        ):
            continue
        if path == Path(__file__) or path.parent.name == "golden":
            continue
        for line, text in texts(path):
            for number, part in enumerate(text.splitlines() or [""]):
                for pattern, say in _CHECKS:
                    for word in pattern.findall(part):
                        yield f"{path.relative_to(root)}:{line + number}: {word!r}: say {say}"


if __name__ == "__main__":
    found = list(places(ROOT))
    print("\n".join(found))
    sys.exit(bool(found))
