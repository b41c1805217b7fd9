"""Tests that the lesson's script has the commands of its page, in the same order."""

import re
import shlex

from testkit.paths import ROOT


def commands(text):
    """Return the tetractl commands of a text, each without its folder of logs and --rate."""
    found = []
    for command in re.findall(r"tetractl (?:play|run|stats) (?:\\\n|.)*", text):
        words = shlex.split(command.replace("\\\n", " "))
        for option in ("--out", "--rate"):
            if option in words:
                at = words.index(option)
                del words[at : at + 2]
        found.append(words)
    return found


def test_the_script_has_the_commands_of_the_page():
    page = (ROOT / "docs" / "how-to" / "lesson.md").read_text()
    lesson = page[page.index("## 1.") :]
    blocks = "\n".join(re.findall(r"```(?:sh|console)\n(.*?)```", lesson, re.DOTALL))
    script = (ROOT / "examples" / "lesson.sh").read_text()
    assert commands(script) == commands(blocks)


def test_the_script_shows_every_trial_at_life_speed():
    script = (ROOT / "examples" / "lesson.sh").read_text()
    assert script.count("tetractl run") == script.count("--trials 1 --rate 1")
