import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from support.batches import DISTURBED, REFERENCE, SCALE, batch, experiment, group, result

from tetractl.core.commands import Verdict
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.table.terminal_table import WIDTH, latex, markdown, print_tables
from tetractl.results.contrast import contrast
from tetractl.results.tables import summary, tables

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
SPEC = experiment(reference=REFERENCE, scale=SCALE, plant=DISTURBED)


def printed(*groups, of=tables, **console):
    out = io.StringIO()
    print_tables(of(contrast(groups)), Console(file=out, **console))
    return out.getvalue()


def test_the_summary_of_a_batch_is_what_one_needs_in_at_most_twelve_lines():
    """With the logs' folder, the next command and a blank line, `run` prints twelve."""
    lines = printed(group(batch(ERRORS, SPEC)), of=summary).splitlines()
    assert [line.split()[0] for line in lines[3:5]] == ["total", "published"]
    assert [line.partition(":")[0] for line in lines[5:-1]] == [
        "difference from published",
        "disturbances",
        "outcomes",
        "entered an obstacle",
    ]
    assert lines[-1] == "" and len(lines) <= 10
    assert not re.search(r"\b(green|solve|aborted|damaged|attempts|arrived)\b", "\n".join(lines))


def test_the_summary_says_what_is_not_usual_and_where():
    inside = (False,) * 3, (50.0,) * 3
    over_edge = Verdict(Poses.of(np.zeros((3, 3))), *inside, edge=(5.0, -1.0, 5.0))
    trials = batch(ERRORS, SPEC, verdict=over_edge)
    trials[3] = replace(trials[3], log="runs/a/trial-003.mcap", recovered=True)
    trials[4] = replace(
        trials[4], result=result([1, 2, 3], outcome=Outcome.ABORTED, reason="pulled")
    )
    ours, theirs = group(trials, name="a"), group(batch(ERRORS[:9] * 2, SPEC), name="b")
    lines = printed(ours, theirs, of=summary).splitlines()
    assert lines[6].startswith("a - b: no significant difference, ")
    assert lines[6].endswith(" (paired t, 17 pairs)")
    rows = dict(line.split(": ", 1) for line in lines[7:-1])
    assert rows["outcomes"].startswith("a: 19 sequence completed, 1 aborted; b: 18 ")
    assert rows["left the arena"] == "a: 19 of 20 (centres)"
    assert rows["read from damaged logs"] == "a: 1"
    assert rows["flagged"] == "a: trial-000 (blue left the arena) and 19 more"
    assert not {"difference from published", "disturbances"} & set(rows)
    lines = printed(ours, of=summary).splitlines()
    rows = dict(line.split(": ", 1) for line in lines[5:-1])
    assert rows["outcomes"].startswith("19 sequence completed (every signal")
    assert rows["left the arena"].startswith("19 of 20 (95 % interval")
    assert "; trial-003: blue left the arena, read from a damaged log" in rows["flagged"]
    assert "; trial-004: excluded, pulled" in rows["flagged"]


@pytest.mark.parametrize("width", [80, 100])
def test_the_summary_takes_twelve_lines_of_a_terminal(width):
    edge = Verdict(Poses.of(np.zeros((3, 3))), *((False,) * 3, (50.0,) * 3), edge=(5.0, -1.0, 5.0))
    bodies = experiment(
        reference=REFERENCE,
        plant=DISTURBED,
        controller={"type": "mpc", "collision": {"radius": 47}},
    )
    ours, paper = group(batch(ERRORS, bodies)), group(batch(ERRORS, SPEC, verdict=edge))
    two = (replace(ours, name="ours"), replace(paper, name="paper"))
    for groups in ((ours,), two):
        lines = printed(*groups, of=summary, width=width, force_terminal=True).splitlines()
        assert len([line for line in lines if line]) <= 12 - 2 * (len(groups) == 1)  # of `run`


def test_published_results_that_differ_have_a_row_each_with_their_batches():
    """Regression: only the first had one, and a batch of that name hid it."""
    other = experiment(reference=REFERENCE | {"mean": 500.0}, scale=SCALE, plant=DISTURBED)
    a, b = group(batch(ERRORS, SPEC), name="a"), group(batch(ERRORS, SPEC), name="published")
    c = group(batch(ERRORS, other), name="c")
    (alike, *_), (different, *_) = summary(contrast([a, b])), summary(contrast([a, b, c]))
    assert list(alike.columns[0].values) == ["a", "published", "published"]
    assert list(different.columns[0].values) == [
        *("a", "published", "c"),
        *("published for a, published", "published for c"),
    ]
    assert list(different.columns[2].values)[3:] == [648.6, 500.0]


def test_the_verdicts_on_many_batches_are_a_table():
    named = [group(batch(ERRORS[: 9 + i]), name=f"g{i}") for i in range(3)]
    errors, compared = summary(contrast(named))
    assert len(errors) == 3
    assert [row[0] for row in compared.rows] == ["g0 - g1", "g0 - g2", "g1 - g2"]


def test_without_a_terminal_lines_are_plain_and_whole():
    trials = batch(ERRORS, SPEC)
    path = "/".join(["folder"] * 40) + "/trial.mcap"
    trials[0] = replace(trials[0], log=path, recovered=True)
    text = printed(group(trials))
    assert "\x1b" not in text
    assert path in text


def test_a_terminal_of_80_columns_shows_the_whole_table():
    text = printed(group(batch(ERRORS, SPEC)), width=80, force_terminal=True)
    assert "…" not in text
    # title, header, rule, five rows and a blank line: none is wrapped
    assert text.split("Trials")[0].count("\n") == 9


def test_control_codes_in_a_log_never_reach_the_screen():
    trials = batch(ERRORS[:2])
    sly = result([1, 2, 3], outcome=Outcome.ABORTED, reason="\x1b]0;gone\x07[red]x[/red]")
    trials[0] = replace(trials[0], result=sly)
    text = printed(group(trials))
    assert "\x1b" not in text
    assert "[red]x[/red]" in text


def test_trials_left_out_are_listed_with_their_reason():
    trials = batch(ERRORS[:4])
    trials[1] = replace(
        trials[1], result=result([1, 2, 3], outcome=Outcome.ABORTED, reason="pulled")
    )
    trials[2] = replace(trials[2], recovered=True)
    text = printed(group(trials))
    assert "3 of 4 trials valid" in text
    assert "trial-001.mcap   aborted" in text
    assert "excluded, pulled" in text
    assert "sequence completed   read from a damaged log" in text
    assert "Flagged trials" not in printed(group(batch(ERRORS[:4])))


def test_markdown_has_as_many_cells_in_every_row():
    ours = group(batch(ERRORS, SPEC))
    for table in markdown(tables(contrast([ours, ours]))).split("**")[2::2]:
        lines = table.strip().splitlines()
        assert len({line.count("|") for line in lines}) == 1
        assert set(lines[1]) <= set("|-: ")


def test_latex_is_booktabs_with_special_characters_escaped():
    scale = SCALE | {"name": "T_p & 100% ^"}
    spec = experiment(reference=REFERENCE, scale=scale, plant=DISTURBED)
    text = latex(tables(contrast([group(batch(ERRORS, spec))])))
    assert [text.count(rf"\{mark}{{tabular}}") for mark in ("begin", "end")] == [1, 1]
    assert [text.count(rf"\{mark}{{tabularx}}") for mark in ("begin", "end")] == [1, 1]
    assert text.count(r"\toprule") == text.count(r"\bottomrule") == 2
    assert r"T\_p \& 100\% \textasciicircum{}" in text
    cells = [line.count(" & ") for line in text.splitlines() if line.startswith(("total", "green"))]
    assert set(cells) == {7}


def test_latex_has_units_minus_signs_and_a_width():
    ours, theirs = group(batch(ERRORS, SPEC)), group(batch(ERRORS[:9], SPEC))
    text = latex(tables(contrast([ours, theirs])))
    assert "error [mm] & n & mean" in text
    assert r"[$\mu$m]" in text
    assert "[um]" not in text
    assert "Final total errors of 2 batches, disturbed simulation" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert not [row for row in rows if re.search(r"(?<![\w.$])-\d", row)]
    assert re.search(r"difference from published & \$-\$\d", text)
    assert r" & -- & --" in text
    assert r"arrived & -- (no arrival\_tolerance)" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\resizebox{\ifdim\width>\linewidth")
    assert text.count(r"\begin{tabularx}{\linewidth}") == 3
    one, other = (group(batch(ERRORS, SPEC), name=name) for name in ("[a]", "b"))
    assert "{[}a] & " in latex(summary(contrast([one, other])))  # "\\ [a]" would be a length


def shown(summary, label, *comparison):
    """The value of one row of the tables of figures."""
    lines = printed(summary, *comparison).splitlines()
    (line,) = [line for line in lines if line.strip().startswith(label)]
    return line.strip().removeprefix(label).strip()


def test_the_table_says_the_plant():
    plain = group(batch(ERRORS, experiment(reference=REFERENCE, scale=SCALE)))
    text = printed(plain)
    assert text.startswith("three-m3pi, undisturbed simulation: final error [mm], 20 of 20")
    assert "scaled" not in text
    assert shown(plain, "difference from published") == "- (not real robots)"
    disturbed = group(batch(ERRORS, SPEC))
    assert "assumed in the spec, not measured" in printed(disturbed)
    assert shown(disturbed, "difference from published").endswith("(Welch's t)")
    both = printed(disturbed, plain)
    (row,) = [line for line in both.splitlines() if line.strip().startswith("plant")]
    assert row.split() == ["plant", "disturbed", "simulation", "undisturbed", "simulation"]
    assert "differ in more than the" in both


def test_the_tail_of_the_errors_has_a_row_with_the_bound_of_the_spec_or_ten_medians():
    rows = [[10.0]] * 19 + [[450.0]]
    label = "errors above 10 times the median"
    assert shown(group(batch(rows)), label) == "1 of 20 above 100.0 mm (95 % interval 1 to 24 %)"
    bounded = group(batch(rows, experiment(1, error_bound=500.0)))
    label = "errors above error_bound"
    assert shown(bounded, label) == "0 of 20 above 500.0 mm (95 % interval 0 to 16 %)"
    assert contrast([bounded, bounded]).contrasts[0].differs == ()


def test_a_long_list_of_flagged_trials_is_cut():
    text = printed(group(batch(ERRORS * 2, outcome=Outcome.STEPS_MAX)))
    assert "20 more" in text
    assert text.count("did not end in") == 20


def test_more_groups_than_fit_abreast_have_tables_of_their_own():
    named = [group(batch(ERRORS[: 9 + i]), name=f"g{i}") for i in range(4)]
    found = [table for table in tables(contrast(named)) if table.title == "Trials"]
    assert [table.header for table in found] == [["figure", "g0", "g1", "g2"], ["figure", "g3"]]
    assert max(map(len, printed(*named).splitlines())) <= WIDTH
