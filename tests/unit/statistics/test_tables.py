"""Tests of the tables and the summary of batches, as text, Markdown and LaTeX."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group, result

from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.statistics.describe import contrast
from tetractl.statistics.tables import summary, tables
from tetractl.tools.table.terminal_table import WIDTH, latex, markdown, print_tables

TRIALS = 20
ERRORS = np.random.default_rng(4).gamma(4, 50, (TRIALS, 3)).tolist()  # of three robots [mm]
SPEC = experiment(reference=REFERENCE, plant=DISTURBED)
PULLED = result([1, 2, 3], outcome=Outcome.ABORTED, reason="pulled")
BLUE_LEFT_ARENA = Verdict(
    final=Poses.from_array(np.zeros((3, 3))),
    entered=(False, False, False),
    clearance=(50.0, 50.0, 50.0),
    edge=(5.0, -1.0, 5.0),
)


def described(errors=ERRORS, spec=SPEC, name="", **result_fields):
    """A batch of one trial a row of errors, described."""
    return group(batch(errors, spec, **result_fields), name=name)


def printed(*groups, layout=tables, **console):
    """What is printed of groups: their tables, or their summary."""
    out = io.StringIO()
    shown_tables = layout(contrast(groups))
    print_tables(shown_tables, Console(file=out, **console))
    return out.getvalue()


def in_latex(*groups, layout=tables):
    shown_tables = layout(contrast(groups))
    return latex(shown_tables)


def labelled(lines):
    """Lines of a summary, by their labels."""
    return dict(line.split(": ", 1) for line in lines)


def value_of(label, *groups):
    """The value of one row of the tables of figures."""
    lines = [line.strip() for line in printed(*groups).splitlines()]
    (line,) = [line for line in lines if line.startswith(label)]
    return line.removeprefix(label).strip()


def test_the_summary_of_a_batch_is_what_one_needs_in_at_most_twelve_lines():
    """With the logs' folder, the next command and a blank line, `run` prints twelve."""
    text = printed(described(), layout=summary)
    lines = text.splitlines()
    assert lines[3].startswith(" total ")
    assert lines[4].startswith(" published ")
    assert list(labelled(lines[5:-1])) == [
        "disturbances",
        "outcomes",
        "entered an obstacle",
    ]
    assert lines[-1] == ""
    assert len(lines) <= 10
    assert not re.search(r"\b(green|solve|aborted|damaged|attempts|arrived)\b", text)


def odd_batch():
    """All left the arena; trial 3 is read from a damaged log, trial 4 was aborted."""
    trials = batch(ERRORS, SPEC, verdict=BLUE_LEFT_ARENA)
    trials[3] = replace(trials[3], log="runs/a/trial-003.mcap", recovered=True)
    trials[4] = replace(trials[4], result=PULLED)
    return group(trials, name="a")


def test_the_summary_says_what_is_not_usual_and_where():
    lines = printed(odd_batch(), layout=summary).splitlines()
    rows = labelled(lines[5:-1])
    assert rows["outcomes"].startswith("19 sequence completed (every signal")
    assert rows["left the arena"].startswith("19 of 20 (95 % interval")
    damaged = "; trial-003: excluded, blue left the arena, read from a damaged log"
    assert damaged in rows["flagged"]
    assert "; trial-004: excluded, pulled" in rows["flagged"]
    assert lines[0].endswith("18 of 20 trials valid")


def test_published_results_that_differ_have_a_row_each_with_their_batches():
    """Regression: only the first had one, and a batch of that name hid it."""
    other_mean = experiment(reference=REFERENCE | {"mean": 500.0}, plant=DISTURBED)
    a = described(name="a")
    b = described(name="published")
    c = described(spec=other_mean, name="c")
    alike, *_ = summary(contrast([a, b]))
    assert list(alike.columns[0].values) == ["a", "published", "published"]
    different, *_ = summary(contrast([a, b, c]))
    assert list(different.columns[0].values) == [
        "a",
        "published",
        "c",
        "published for a, published",
        "published for c",
    ]
    assert list(different.columns[2].values)[3:] == [REFERENCE["mean"], 500.0]


def test_the_verdicts_on_many_batches_are_a_table():
    groups = [described(ERRORS[: 9 + i], spec=None, name=f"g{i}") for i in range(3)]
    errors, compared = summary(contrast(groups))
    assert len(errors) == 3
    assert [row[0] for row in compared.rows] == ["g0 - g1", "g0 - g2", "g1 - g2"]


def test_control_codes_in_a_log_never_reach_the_screen():
    trials = batch(ERRORS[:2])
    sly = result([1, 2, 3], outcome=Outcome.ABORTED, reason="\x1b]0;gone\x07[red]x[/red]")
    trials[0] = replace(trials[0], result=sly)
    text = printed(group(trials))
    assert "\x1b" not in text
    assert "[red]x[/red]" in text


def test_trials_left_out_are_listed_with_their_reason():
    trials = batch(ERRORS[:4])
    trials[1] = replace(trials[1], result=PULLED)
    trials[2] = replace(trials[2], recovered=True)
    text = printed(group(trials))
    assert "2 of 4 trials valid" in text
    assert "trial-001.mcap   aborted" in text
    assert "excluded, pulled" in text
    assert "sequence completed   excluded, read from a damaged log" in text


def test_markdown_has_as_many_cells_in_every_row():
    ours = described()
    text = markdown(tables(contrast([ours, ours])))
    bodies = text.split("**")[2::2]  # of tables, below their titles
    assert bodies
    for body in bodies:
        lines = body.strip().splitlines()
        assert len({line.count("|") for line in lines}) == 1
        assert set(lines[1]) <= set("|-: ")


def test_latex_is_booktabs_with_special_characters_escaped():
    text = in_latex(described(name="ours"), described(ERRORS[:9], name="T_p & 100% ^"))
    for table in ("tabular", "tabularx"):
        assert text.count(rf"\begin{{{table}}}") == text.count(rf"\end{{{table}}}") > 0
    assert text.count(r"\toprule") == text.count(r"\bottomrule")
    assert r"T\_p \& 100\% \textasciicircum{}" in text
    rows = [line for line in text.splitlines() if line.startswith(("total", "green"))]
    assert {row.count(" & ") for row in rows} <= {7}


def test_latex_has_units_minus_signs_and_a_width():
    small = experiment(units={"length": "um"}, plant=DISTURBED)
    larger = [[2 * error for error in errors] for errors in ERRORS[:9]]
    text = in_latex(described(spec=small), described(larger, spec=small))
    assert r"error [$\mu$m] & n & mean" in text
    assert "[um]" not in text
    assert "Final total errors of 2 batches, disturbed simulation" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    hyphen_for_minus = r"(?<![\w.$])-\d"
    assert not [row for row in rows if re.search(hyphen_for_minus, row)]
    assert re.search(r" & \$-\$\d", text)
    assert r" & -- & --" in text
    assert r"arrived & -- (no arrival\_tolerance)" in text
    assert not [row for row in rows if " - " in row]
    brief = in_latex(described(name="ours"), described(ERRORS[:9], name="theirs"), layout=summary)
    (note,) = [line for line in brief.splitlines() if line.startswith(r"\par\medskip")]
    assert "ours $-$ theirs: " in note
    assert not re.search(r"\. [a-z]", note)  # no small letter after a stop
    assert text.count(r"\begin{tabular}") == text.count(r"\resizebox{\ifdim\width>\linewidth")
    assert text.count(r"\begin{tabularx}{\linewidth}") == 3


def test_the_table_of_an_undisturbed_simulation_compares_with_nothing_published():
    undisturbed = described(spec=experiment(reference=REFERENCE))
    text = printed(undisturbed)
    assert text.startswith("three-m3pi, undisturbed simulation: final error [mm], 20 of 20")
    assert value_of("difference from published", undisturbed) == "- (not real robots)"


def test_the_table_of_a_disturbed_simulation_says_that_disturbances_are_assumed():
    assert "assumed in the spec, not measured" in printed(described())
    assert value_of("difference from published", described()) == "- (not real robots)"


ONE_FAR = [[10.0]] * 19 + [[450.0]]


def test_the_tail_of_the_errors_is_what_lies_above_the_bound_of_the_spec():
    bounded = described(ONE_FAR, spec=experiment(1, error_bound=500.0))
    text = value_of("errors above error_bound", bounded)
    assert text == "0 of 20 above 500.0 mm (95 % interval 0 to 16 %)"
    assert contrast([bounded, bounded]).contrasts[0].differs == ()


def test_more_groups_than_fit_abreast_have_tables_of_their_own():
    groups = [described(ERRORS[: 9 + i], spec=None, name=f"g{i}") for i in range(4)]
    headers = [table.header for table in tables(contrast(groups)) if table.title == "Trials"]
    assert headers == [["figure", "g0", "g1", "g2"], ["figure", "g3"]]
    lines = printed(*groups).splitlines()
    assert max(len(line) for line in lines) <= WIDTH


@pytest.mark.parametrize("layout", [summary, tables])
def test_a_batch_without_a_valid_trial_is_compared_with_nothing(layout):
    """Regression: after Ctrl-C in the first trial, the difference was "- mm (Welch's t)"."""
    text = printed(described(outcome=Outcome.INTERRUPTED), layout=layout)
    assert "0 of 20 trials valid" in text
    assert "difference" not in text
