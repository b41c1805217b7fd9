"""Tests that broken tables, specs and names are refused in one line, at every command."""

import pytest
from testkit import random_trials
from testkit.cli import tetractl
from testkit.mutate import rewrite, stating
from testkit.running import QUICK

from tetractl.log.format.channels import RUN
from tetractl.log.format.tetractl_pb2 import Fact
from tetractl.log.read.salvage import scan

pytestmark = pytest.mark.slow


def refused(done, *words, code=2):
    assert done.returncode == code, done
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert all(word in line for word in words), line
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("fact", "drawn"),
    [
        ("{", False),
        ("[1]", False),
        ("1" * 400, False),
        pytest.param("[1e300, 1, 1]", True, marks=pytest.mark.long),
    ],
)
def test_the_estimates_of_a_log_with_any_fact_are_drawn_or_told(fact, drawn, tmp_path):
    contents = scan(random_trials.write(random_trials.trial(steps=3), tmp_path / "made.mcap"))
    facts = [Fact(key="true_a", value=fact)]
    log = rewrite(contents, tmp_path / "log.mcap", stating(contents, RUN, facts=facts))
    done = tetractl(tmp_path, "plot", log, "--kind", "over-time", "-o", "e.png")
    if drawn:
        assert done.returncode == 0, done
        assert (tmp_path / "e.png").exists()
    else:
        refused(done, "log.mcap", "true_a", code=1)


def test_the_unit_of_identified_values_is_shown_as_a_terminal_may(tmp_path):
    """Regression: a change of the writing direction came to the terminal."""
    value = "{value: 1}"
    fields = ("a", "speed", "heading_bias", "position_noise", "heading_noise", "heading_walk")
    robot = ", ".join(f"{field}: {value}" for field in fields)
    head = f'identified: "1"\norigin: lab\nunit: "\\u202e"\ndead_time: {value}\n'
    (tmp_path / "measured.yaml").write_text(f"{head}robots: {{r: {{{robot}}}}}\n")
    (tmp_path / "spec.yaml").write_text("identified: measured.yaml\n" + QUICK)
    done = tetractl(tmp_path, "validate", "spec.yaml")
    assert done.returncode == 2
    assert (
        "measured.yaml: unit: \\u202e: differs from the length unit of the spec, mm" in done.stdout
    )
