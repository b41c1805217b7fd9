import io
import re
from dataclasses import replace

import numpy as np
from rich.console import Console
from support.batches import DISTURBED, REFERENCE, SCALE, batch, experiment, group, result

from tetractl.core.plan import Outcome
from tetractl.core.table.terminal_table import WIDTH, latex, markdown, print_tables
from tetractl.results.contrast import contrast
from tetractl.results.tables import tables

ERRORS = np.random.default_rng(4).gamma(4, 50, (20, 3)).tolist()
SPEC = experiment(reference=REFERENCE, scale=SCALE, plant=DISTURBED)


def printed(*groups, **console):
    out = io.StringIO()
    print_tables(tables(contrast(groups)), Console(file=out, **console))
    return out.getvalue()


def test_without_a_terminal_lines_are_plain_and_whole():
    trials = batch(ERRORS, SPEC)
    path = "/".join(["folder"] * 40) + "/trial.mcap"
    trials[0] = replace(trials[0], path=path, recovered=True)
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
    assert "3 of 4 trials complete" in text
    assert "trial-001.mcap   aborted" in text
    assert "not in the means, pulled" in text
    assert "in the means, read from a damaged log" in text
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
    assert "three-m3pi against three-m3pi: final total error, disturbed simulation" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert not [row for row in rows if re.search(r"(?<![\w.$])-\d", row)]
    assert re.search(r"difference from published \[mm\] & \$-\$\d", text)
    assert r" & -- & --" in text
    assert r"arrived, 95 \% interval & -- (no arrival\_tolerance)" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\resizebox{\ifdim\width>\linewidth")
    assert text.count(r"\begin{tabularx}{\linewidth}") == 3


def shown(summary, label, *comparison):
    """The value of one row of the tables of figures."""
    lines = printed(summary, *comparison).splitlines()
    (line,) = [line for line in lines if line.strip().startswith(label)]
    return line.strip().removeprefix(label).strip()


def test_the_table_says_the_plant():
    plain = group(batch(ERRORS, experiment(reference=REFERENCE, scale=SCALE)))
    text = printed(plain)
    assert text.startswith("three-m3pi, undisturbed simulation: final error [mm], 20 of 20")
    assert "p (Welch)" not in text
    assert "scaled" not in text
    assert shown(plain, "difference from published [mm]") == "- (not real robots)"
    disturbed = group(batch(ERRORS, SPEC))
    assert "assumed in the spec, not measured" in printed(disturbed)
    assert shown(disturbed, "p (Welch)")
    both = printed(disturbed, plain)
    (row,) = [line for line in both.splitlines() if line.strip().startswith("plant")]
    assert row.split() == ["plant", "disturbed", "simulation", "undisturbed", "simulation"]
    assert "differ in more than the" in both


def test_the_tail_of_the_errors_has_a_row_with_the_bound_of_the_spec_or_ten_medians():
    rows = [[10.0]] * 19 + [[450.0]]
    label = "trials above 10 medians, 95 % interval"
    assert shown(group(batch(rows)), label) == "1 of 20 above 100.0 mm (1 to 24 %)"
    bounded = group(batch(rows, experiment(1, error_bound=500.0)))
    label = "trials above error_bound, 95 % interval"
    assert shown(bounded, label) == "0 of 20 above 500.0 mm (0 to 16 %)"
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
