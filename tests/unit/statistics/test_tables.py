"""Tests of the tables and the summary of batches, as text, Markdown and LaTeX."""

import io
import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from testkit.batches import DISTURBED, REFERENCE, batch, experiment, group, result

from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.log.read.trial_log import Origin
from tetractl.statistics.describe import contrast
from tetractl.statistics.open_batch import Damaged
from tetractl.statistics.tables import (
    decimals_shown,
    error_format,
    figure_lines,
    summary,
    tables,
    trials_listed,
)
from tetractl.tools.table.terminal_table import (
    DEFAULT_WIDTH,
    format_latex,
    format_markdown,
    print_tables,
)

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
    return format_latex(shown_tables)


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
    text = format_markdown(tables(contrast([ours, ours])))
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
    assert max(len(line) for line in lines) <= DEFAULT_WIDTH


@pytest.mark.parametrize("layout", [summary, tables])
def test_a_batch_without_a_valid_trial_is_compared_with_nothing(layout):
    """Regression: after Ctrl-C in the first trial, the difference was "- mm (Welch's t)"."""
    text = printed(described(outcome=Outcome.INTERRUPTED), layout=layout)
    assert "0 of 20 trials valid" in text
    assert "difference" not in text


# ---- Numbers ----


@pytest.mark.parametrize(
    ("width", "height", "decimals"),
    [(1600, 1800, 3), (9.0, 0.5, 6), (0.5, 9.0, 6), (100, 99, 4), (99, 100, 4), (1e7, 2e7, 0)],
)
def test_errors_have_the_decimals_that_resolve_a_millionth_of_the_longer_side(
    width, height, decimals
):
    arena = SPEC.arena.model_copy(update={"width": width, "height": height})
    assert decimals_shown(SPEC.model_copy(update={"arena": arena})) == decimals


def test_no_arena_is_so_small_that_errors_have_more_than_nine_decimals():
    arena = SPEC.arena.model_copy(update={"width": 1e-6, "height": 1e-6})
    assert decimals_shown(SPEC.model_copy(update={"arena": arena})) == 9


@pytest.mark.parametrize(
    ("smallest", "value", "text"),
    [
        (2.34, 2.3456, "2.35"),
        (2.34, 0.0123, "0.01"),
        (2.34, 23.4, "23.40"),  # exactly ten times: as the smallest
        (2.34, 23.5, "23.5"),
        (2.34, 1234.5, "1234"),
        (0.0, 1234.5, "1234.5"),  # nothing is ten times 0
    ],
)
def test_errors_far_above_the_smallest_have_three_digits_of_their_own(smallest, value, text):
    assert error_format(smallest, 9)(value) == text


def test_no_error_has_more_decimals_than_are_asked_for():
    show = error_format(0.00123, 2)
    assert show(0.00123) == "0.00"
    assert show(0.5) == "0.50"


# ---- Titles and notes of several batches ----


def lab(trials, origin=Origin.LAB):
    return [replace(trial, origin=origin, digest=trial.log) for trial in trials]


def notes_of(*groups):
    """The lines below the first table of a summary."""
    return summary(contrast(groups))[0].note.splitlines()


@pytest.mark.parametrize(
    ("plants", "ending"),
    [
        (({"type": "sim"}, {"type": "sim"}), "undisturbed simulation"),
        ((DISTURBED, DISTURBED), "disturbed simulation (disturbances assumed)"),
        (
            ({"type": "sim"}, DISTURBED),
            "undisturbed simulation, disturbed simulation (disturbances assumed)",
        ),
    ],
)
def test_the_title_of_batches_says_their_plants_and_whether_disturbances_are_assumed(
    plants, ending
):
    groups = [described(spec=experiment(plant=plant)) for plant in plants]
    assert (
        summary(contrast(groups))[0].title
        == f"Final total errors of {len(groups)} batches, {ending}"
    )


def test_p_is_said_to_be_corrected_only_if_several_comparisons_are_tested():
    two = [described(ERRORS[: 9 + i], spec=None, name=f"g{i}") for i in range(2)]
    three = [*two, described(ERRORS[:12], spec=None, name="g2")]
    title = "Comparison of the mean total errors"
    titles = [
        [table.title for table in tables(contrast(groups)) if table.title.startswith(title)]
        for groups in (two, three)
    ]
    assert titles == [[title], [f"{title}, p corrected for 3 tests"]]
    untested = [two[0], group(lab(batch(ERRORS)), name="lab")]
    assert [table.title for table in tables(contrast(untested)) if "Comparison" in table.title] == [
        title
    ]


def basis_of(*groups):
    """The cells of the one row of the table that shows how two batches were compared."""
    (table,) = [t for t in tables(contrast(groups)) if t.title == "Methods of the comparisons"]
    (row,) = table.rows
    return defaultdict(str, zip(table.header, row, strict=True))


def test_the_basis_of_a_comparison_names_its_tests_its_power_and_what_differs():
    alike = basis_of(described(name="a"), described(name="b"))
    assert alike["tests"] == "paired t, signed rank"
    assert re.fullmatch(r"0\.\d\d sd", alike["detectable at 80 % power"])
    assert alike["why not paired"] == ""  # a column without entries is left out
    assert alike["differs in"] == "nothing"
    other = basis_of(
        described(name="a"),
        described(spec=experiment(plant=DISTURBED | {"dead_time": 0.1}), name="b"),
    )
    assert other["tests"] == "Welch's t, rank sum"
    assert "plant.dead_time" in other["differs in"]
    assert "differ in more" in other["why not paired"]


def test_batches_from_two_kinds_of_plant_have_no_tests_and_no_power():
    basis = basis_of(described(name="a"), group(lab(batch(ERRORS, SPEC)), name="b"))
    assert "why not paired" in basis
    assert basis.keys().isdisjoint({"tests", "p (rank test)", "detectable at 80 % power"})
    groups = [described(name=name) for name in "ab"]
    *_, rests = (
        t
        for t in tables(contrast([*groups, group(lab(batch(ERRORS, SPEC)), name="lab")]))
        if t.title == "Methods of the comparisons"
    )
    cells = {column.name: list(column.values) for column in rests.columns}
    assert cells["tests"] == ["paired t, signed rank", "-", "-"]
    assert cells["detectable at 80 % power"][1:] == ["-", "-"]
    assert cells["differs in"] == ["nothing"] * 3


def test_differences_have_the_digits_of_the_largest_of_them():
    larger = (np.array(ERRORS) + 30).tolist()
    much_larger = (np.array(ERRORS) + 400).tolist()
    groups = [
        described(errors, spec=experiment(plant=DISTURBED), name=name)
        for name, errors in (("a", ERRORS), ("b", larger), ("c", much_larger))
    ]
    _, compared = summary(contrast(groups))
    (column,) = [column for column in compared.columns if column.name == "difference"]
    assert column.texts == ["-90", "-1200", "-1110"]


def test_a_verdict_says_how_many_pairs_it_rests_on_and_without_pairs_only_its_test():
    lower = (np.array(ERRORS) / 4).tolist()
    a, b = described(lower, name="a"), described(name="b")
    assert re.fullmatch(
        r"a - b: lower mean error, -\d+\.\d mm \(95 % interval -\S+ to -\S+\), p < 0\.001 "
        r"\(paired t, 20 pairs\)",
        notes_of(a, b)[0],
    )
    other_seed = [replace(trial, seed=2) for trial in batch(ERRORS, SPEC)]
    assert notes_of(a, group(other_seed, name="b"))[0].endswith(" (Welch's t)")
    assert notes_of(b, a)[0].startswith("b - a: higher mean error, ")
    assert notes_of(b, described(name="c"))[0].startswith("b - c: no verdict (no interval: ")


def published_notes(*groups):
    return [line for line in notes_of(*groups) if line.startswith("difference from published")]


def test_only_one_batch_of_a_real_lab_is_compared_with_a_published_result():
    real = group(lab(batch(ERRORS, SPEC)))
    ((note),) = published_notes(real)
    assert re.search(r": -?\d+\.\d mm \(95 % interval .*\), p .* \(Welch's t\)$", note)
    assert published_notes(real, real) == []
    assert published_notes(described()) == []
    assert published_notes(group(lab(batch(ERRORS, SPEC), Origin.EMULATED))) == []
    without = group(lab(batch(ERRORS, experiment(plant=DISTURBED))))
    assert published_notes(without) == []
    nothing_valid = group(lab(batch(ERRORS, SPEC, outcome=Outcome.ABORTED)))
    assert published_notes(nothing_valid) == []


def flagged_notes(*numbers):
    """The notes about flagged trials in a summary of two batches, of which one has these."""
    trials = batch(ERRORS, SPEC)
    for number in numbers:
        trials[number] = replace(trials[number], result=PULLED)
    notes = notes_of(group(trials, name="a"), described(name="b"))
    return [line for line in notes if line.startswith("flagged: ")]


def test_beside_another_batch_only_the_first_flagged_trial_is_named_and_the_others_counted():
    assert flagged_notes() == []
    assert flagged_notes(5) == ["flagged: a: trial-005 (excluded, pulled)"]
    assert flagged_notes(5, 7, 9) == ["flagged: a: trial-005 (excluded, pulled) and 2 more"]


def test_a_finding_of_every_batch_is_told_once_with_their_names():
    notes = notes_of(described(name="a"), described(name="b"))
    (entered,) = [line for line in notes if line.startswith("entered an obstacle")]
    assert entered == "entered an obstacle: a, b: 0 of 20 (centres)"


@pytest.mark.parametrize(("count", "rows"), [(20, 20), (21, 21), (24, 21)])
def test_the_table_of_flagged_trials_ends_with_the_number_of_those_left_out(count, rows):
    trials = batch([[1.0, 2.0, 3.0]] * 25, SPEC)
    aborted = [replace(trial, result=PULLED) for trial in trials[:count]]
    (table,) = [
        t
        for t in tables(contrast([group([*aborted, *trials[count:]])]))
        if t.title == "Flagged trials"
    ]
    assert len(table) == rows
    *_, (last, *_) = table.rows
    assert last == (f"{count - 20} more" if count > 20 else "trial-019.mcap")


def tail_of(errors):
    (figure,) = [
        figure
        for figure in figure_lines(described([[error] for error in errors], spec=experiment(1)))
        if figure.label.startswith("errors above")
    ]
    return figure


def test_errors_far_above_the_others_are_unusual_unless_all_are_tiny():
    """A robot that comes to rest within rounding of its target has only tiny errors."""
    arena_mm = 1800
    far = tail_of([1.0] * 9 + [11.0])
    assert far.unusual
    assert far.text.startswith("1 of 10 above 10.0 mm")
    assert not tail_of([1.0] * 9 + [9.0]).unusual
    tiny = 1e-6 * arena_mm
    assert not tail_of([tiny / 100] * 9 + [0.99 * tiny]).unusual
    assert tail_of([tiny / 100] * 9 + [1.01 * tiny]).unusual


def test_attempts_and_unreadable_logs_are_unusual_only_if_there_are_some():
    def unusual(described_batch):
        return {figure.label for figure in figure_lines(described_batch) if figure.unusual}

    labels = {"earlier attempts, excluded", "logs that cannot be read"}
    assert not unusual(described()) & labels
    torn = [Damaged("trial-030.mcap", "torn")]
    set_aside = [Damaged("trial-030.attempt-1.mcap", "torn")]
    assert unusual(group(batch(ERRORS), torn)) & labels == {"logs that cannot be read"}
    assert unusual(group(batch(ERRORS), set_aside)) & labels == {"earlier attempts, excluded"}


def test_the_trials_of_a_batch_are_listed_with_error_outcome_and_what_was_unsafe():
    trials = batch(ERRORS[:3], SPEC)
    trials[1] = replace(trials[1], result=replace(PULLED, verdict=BLUE_LEFT_ARENA))
    table = trials_listed(group(trials))
    columns = {column.name: list(column.values) for column in table.columns}
    assert columns["log"] == ["trial-000.mcap", "trial-001.mcap", "trial-002.mcap"]
    assert columns["total error"] == [sum(ERRORS[0]), 6.0, sum(ERRORS[2])]
    assert columns["unsafe"] == ["no", "left the arena", "no"]
    assert columns["outcome"] == ["sequence completed", "aborted", "sequence completed"]
    assert columns["duration"] == [6.2] * 3
    assert columns["steps"] == [31] * 3
    assert table.note.count(";") == 1
    assert table.note.startswith("sequence completed: every signal was sent; aborted: ")
