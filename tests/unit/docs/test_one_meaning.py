"""What several pages and specs call by one name is one thing."""

from solverbench.loop import DISTURBED
from support.paths import ROOT

from tetractl.experiment.load import load_spec

EXPERIMENTS = ROOT / "experiments"


def test_the_disturbances_of_the_solvers_figures_are_those_of_its_page():
    page = (ROOT / "docs/explanation/solver.md").read_text()
    assert all(f"`{setting}`" in page for setting in DISTURBED)


def test_both_controllers_run_on_one_bench():
    ours, published = (
        load_spec(EXPERIMENTS / f"{name}.yaml").experiment
        for name in ("three_m3pi_bench", "three_m3pi_paper_bench")
    )
    assert ours.plant == published.plant
    assert ours.robots == published.robots
    paper = load_spec(EXPERIMENTS / "three_m3pi_paper.yaml").experiment
    assert published.controller == paper.controller
