"""Measures what each rule of the controller gains, with pairs of trials with and without it.

    python benchmarks/rules.py --out logs/rules                    every rule, 6 pairs a world
    python benchmarks/rules.py --rule slack tree --trials 20 --seed 90512 --out logs/rules
    python benchmarks/rules.py --trials 0 --out logs/rules         the table of existing trials

The output is "Every rule, asked" of docs/reference/measured.md. A rule is disabled by replacing a
function or a constant of the controller. It is tested in each world of `benchmarks/worlds` in which
it should help, and in the worlds of `COMMON`, in which it should not. --out keeps a CSV file for
each rule, to which further trials are added. A difference is the value without the rule minus the
value with it, with its 95 % bootstrap interval. A trial counts as touching if a body overlaps an
edge, an obstacle or another body.
"""

import argparse
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from solverbench.report import describe_load, print_progress
from worlds.trials import PAIRS_HEAD, Row, Task, extended, pair_lines

from tetractl.control.estimation import filter, filter_start, reception
from tetractl.control.estimation.filter import FilterBank
from tetractl.control.estimation.kernels import filter_state
from tetractl.control.estimation.prior import Sticks
from tetractl.control.estimation.reception import Reception
from tetractl.control.methods import lengths, mpc, passage, turns
from tetractl.control.methods.fixed_sequence import find_best_stop
from tetractl.control.methods.lengths import Searcher
from tetractl.control.methods.mpc import Mpc
from tetractl.control.methods.mpc_section import PriorSection, RecommendedMpc
from tetractl.control.methods.value import CandidateValues
from tetractl.control.search import margins, near_targets
from tetractl.core.motion_estimate import Estimate
from tetractl.core.poses import Floats

COMMON = ("base", "bench", "base-5hz")
WALLS = ("near-walls", "near-walls-5hz", "gap")
TIME = ("near-equal", "five-robots")
NEVER = Sticks(every_s=1e9)
WHOLE = "whole"  # the controller with all its rules


@dataclass(frozen=True)
class Rule:
    """A rule of the controller, and how to disable it.

    `parts` (owner, name of an attribute, replacement) disable it. `helps` names the worlds in which
    it should help. `assumed` are values of the filter's kernels.
    """

    parts: tuple[tuple[Any, str, Any], ...] = ()
    helps: tuple[str, ...] = ()
    assumed: tuple[tuple[str, float], ...] = ()

    def take_out(self) -> None:
        """Disable the rule in this process."""
        for owner, name, replacement in self.parts:
            patch.object(owner, name, replacement).start()
        if self.assumed:
            from tetractl.control.estimation.kernels import filter as kernel
            from tetractl.control.estimation.kernels import filter_measure

            for name, value in self.assumed:
                for module in (kernel, filter_measure):
                    if hasattr(module, name):
                        patch.object(module, name, value).start()


def _prior(**changes: Any) -> tuple[Any, str, Any]:
    of = PriorSection.of
    return PriorSection, "of", lambda *words: of(*words)._replace(**changes)


def _model(**changes: Any) -> tuple[Any, str, Any]:
    model = filter.filter_model
    return filter, "filter_model", lambda *words: model(*words)._replace(**changes)


def _returns(owner: Any, name: str, value: Any) -> tuple[Any, str, Any]:
    return owner, name, lambda *_: value


def _value(**changes: Any) -> tuple[Any, str, Any]:
    """Create the replacement with which plans are valued as if `changes` held for each of them."""
    plan = CandidateValues.plan_value

    def changed(
        self: CandidateValues, error: float, length: int, is_new: bool, touches: bool = False
    ) -> float:
        return plan(self, error, length, **({"is_new": is_new, "touches": touches} | changes))

    return CandidateValues, "plan_value", changed


def _as_usual(self: Mpc, step: mpc.ControlStep, warm: Any) -> Any:
    stop = self._stop(step, warm, self._lower_bound_of_driving(step, warm))
    return stop or self._go_on(self._search_under_way(step, warm))


def _one_signal_more(self: Mpc, step: mpc.ControlStep, searcher: Searcher, start: Any) -> None:
    """Search lengths that differ by one signal, each from the present plan and without a start."""
    plans = self._plans_of_searches(step.problem, searcher.searches)
    least = min(self._value(step, plan) for plan in plans)
    for length in range(len(start), step.signals_max + 1):
        if step.values.plan_value(0.0, length, length > len(start) + 1) >= least:
            return
        for begin in (lengths.resample(start, length), None):
            search = searcher.search(length, begin)
            if search is None:
                return
            last_index = len(searcher.searches) - 1
            newest = self._plan_of_search(step.problem, searcher.searches, last_index)
            least = min(least, self._value(step, newest))
            if self._is_good(search):
                break


def _stop_now(self: Mpc, problem: Any, within_s: float) -> Any:
    return find_best_stop(problem, self.estimator.directions_at_action, 0.0)


def _stop_unseen(self: Mpc, problem: Any, within_s: float) -> Any:
    return find_best_stop(problem, self.estimator.directions_at_action, within_s)


_with_margins = Mpc._with_margins
_reopen = FilterBank._reopen
_common = filter_state.CommonTimes.of
_off_course = margins.max_deviation


def _known_margins(self: Mpc, problem: Any, estimate: Any) -> Any:
    return _with_margins(self, problem, estimate or self.estimator.present_estimate)


def _off_course_by_uncertainty(
    speed: Floats, held_s: float, dead_time_s: float, estimate: Estimate | None
) -> float:
    """Compute how far robots leave their courses, without wheels that roll on wrongly."""
    uncertain = None if estimate is None else replace(estimate, lag=None)
    return _off_course(speed, held_s, dead_time_s, uncertain)


def _bee_lines(problem: Any, grid: Any) -> Any:
    gaps = np.linalg.norm(grid.centres - problem.targets[:, None], axis=2)
    return gaps.ravel()


def _alone(bank: Any, prior: Any) -> Any:
    """Return the prior of each filter's dead time, as if the other robots gave no information."""
    common = _common(bank, prior)
    deviations = (bank.dead_time_s - prior.dead_time) / (prior.dead_time_std or 1.0)
    likely = np.exp(-(deviations**2) / 2)
    return common._replace(near=np.broadcast_to(likely, common.near.shape).copy())


RULES = {
    # what robots do: tetractl.control.methods.mpc
    "polish before a stop near the time limit": Rule(
        ((Mpc, "_decide_near_time_limit", _as_usual),),
        (
            "sticking-5hz --set controller.time_limit=20",
            "saturated-2 --set controller.time_limit=15",
        ),
    ),
    "stop at the best moment": Rule(((Mpc, "_best_stop", _stop_now),), ("bench", "later")),
    "no late stop near a body": Rule(((Mpc, "_best_stop", _stop_unseen),), WALLS),
    "a plan that collides soon is not driven": Rule(
        (_returns(Mpc, "_collides_soon", False),), WALLS
    ),
    "two dead times until a stop acts": Rule(((mpc, "STOP_DEAD_TIMES", 1.0),), WALLS),
    "turns on the spot": Rule((_returns(mpc, "choose_facing", None),), WALLS),
    "turns to the most room": Rule((_returns(turns, "find_freest_direction", 0.0),), WALLS),
    "turns kept for four steps": Rule(((turns, "STEPS_PER_TURN", 1),), WALLS),
    "other turns after one in vain": Rule(((turns, "FAILED_TURNS_MAX", 1),), WALLS),
    "stay in a hold": Rule(
        (_returns(Mpc, "_stay", None),),
        tuple(
            f"{world} --set hold={{radius: 20, time: 10}}" for world in ("base", "bench", "sides")
        ),
    ),
    # passages: tetractl.control.methods.passage
    "tree": Rule(((mpc, "find_sequences", lambda *_: iter(())),), ("gap", "eight")),
    "thread": Rule(((Mpc, "_drive", lambda _, __, best: best),), ("gap",)),
    "rest where robots stray from a passage": Rule((_returns(Mpc, "_strays", False),), ("gap",)),
    "narrow margins of a tree": Rule(((Mpc, "_with_margins", _known_margins),), ("gap",)),
    "ways of a tree round obstacles": Rule(((passage, "_grid_distances", _bee_lines),), ("gap",)),
    # lengths and values
    "shortening": Rule(
        ((Searcher, "shorten", lambda self, *_: self.searches[-1].length),),
        (*TIME, "sticking-5hz"),
    ),
    "four first plans": Rule(((lengths, "REST_PLANS", 1),), TIME),
    "no more than four first plans": Rule(((lengths, "REST_PLANS", 12),), TIME),
    "slack": Rule(((mpc, "LENGTH_SLACK", 1.0),), (*TIME, "sticking-5hz")),
    "longer plans": Rule((_returns(Mpc, "_search_longer", None),), (*TIME, "sticking-5hz")),
    "lengths that grow by a fifth": Rule(
        ((Mpc, "_search_longer", _one_signal_more),),
        (*TIME, *WALLS, "round-obstacle", "narrow-gap", "sticking-5hz", "cells"),
    ),
    "six signals a robot": Rule(((lengths, "SIGNALS_PER_ROBOT", 1),), TIME),
    "attempts cost": Rule((_value(is_new=False),), ("sticking-5hz", "wander", "strip")),
    "attempts cost more and more": Rule(
        (_returns(RecommendedMpc, "patience_s", math.inf),),
        ("sticking-5hz", "wander", "saturated-2", "cells-pause"),
    ),
    "time has a price": Rule(((CandidateValues, "time_price", 0.0),), ("wander", *TIME)),
    "to touch a margin costs": Rule((_value(touches=False),), WALLS),
    # margins
    "margins for uncertain motion": Rule(((margins, "N_SIGMAS", 0.0),), WALLS),
    "margins for a lost command": Rule(
        (
            (near_targets, "LOST_FRACTION", 0.0),
            (margins, "max_deviation", _off_course_by_uncertainty),
        ),
        (*WALLS, "near-walls-bench", "gap-bench"),
    ),
    # radio: tetractl.control.estimation.reception
    "radio test": Rule(
        ((FilterBank, "tests_radio", property(lambda _: False)),),
        ("sparse-radio", "lossy-radio", "silent"),
    ),
    "a signal is kept": Rule(
        (_returns(Mpc, "_keeps_signal", False),), ("sparse-radio", "lossy-radio")
    ),
    "a sparse radio is shown twice": Rule(
        ((Reception, "is_sparse", property(lambda self: self.times_detected > 0)),),
        ("sparse-radio", "later", "lossy-radio"),
    ),
    "few of directions missed in a row count": Rule(
        ((reception, "MISSED_IN_A_ROW_MAX", 10**6),), ("sparse-radio", "later", "silent")
    ),
    "directions of which frames say nothing": Rule(
        ((reception, "LN_PRODUCT_MIN", 0.0),), ("sparse-radio", "later", "silent")
    ),
    # filter and bank
    "spacing of frames": Rule(((filter, "SPACING_NS", 1),), ("bench", "later")),
    "opening the bank again": Rule((_returns(FilterBank, "_may_reopen", False),), ("later",)),
    "motors may saturate": Rule(
        ((FilterBank, "_reopen", lambda self, frame, heading_fits: _reopen(self, frame, True)),),
        ("saturated-2", "saturated-4"),
    ),
    "shared dead times": Rule(
        ((filter.CommonTimes, "of", staticmethod(_alone)),), ("later", "late", "bench")
    ),
    "a dead time of one's own": Rule(((filter_state, "OWN_PROBABILITY", 0.0),), ("late", "later")),
    "stuck": Rule((_model(sticks=NEVER),), ("sticking", "sticking-5hz", "cells-pause")),
    "frames shown again": Rule((_model(coarse=True),), ("stale", "repeating", "no-frames")),
    "watchdogs": Rule((_model(watchdog_s=math.inf),), ("silent", "sparse-radio", "lossy-radio")),
    "side": Rule(((PriorSection, "side", 0.0),), ("sides", "saturated-2")),
    "marker bias": Rule(((PriorSection, "marker_bias", 0.0),), ("marker", "cells-body")),
    "turn bias": Rule((_prior(heading_bias_std=0.0),), ("marker", "wander")),
    "flow": Rule((_prior(flow_std=0.0),), ("slide", "cells")),
    "a cell's frequencies": Rule(
        ((filter_start, "FREQUENCIES", (1.0,)),), ("cells", "cells-body", "cells-pause")
    ),
    "outlier gate": Rule((), ("stale", "marker", "cells-body"), (("GATE", 1e12),)),
    "missed commands": Rule(
        (),
        ("lossy-radio", "silent"),
        (("LN_HEARD", math.log(1 - 1e-12)), ("LN_MISSED", math.log(1e-12))),
    ),
    "hypotheses alike are one": Rule((), ("lossy-radio",), (("ALIKE", 0.0),)),
    "scale of the noise": Rule(
        (), ("cells", "slow-pictures"), (("SCALE_LEAST", 1.0), ("SCALE_MOST", 1.0))
    ),
    "the camera's pose if none fits": Rule((), ("stale", "marker"), (("LOST_TRACK_S", 1e9),)),
}
"""Each rule by its name."""


def begin_without(name: str) -> None:
    """Start a process without a rule."""
    if name != WHOLE:
        RULES[name].take_out()


def trials_of(name: str, tasks: Sequence[Task], folder: Path) -> dict[Task, Row]:
    """Run the trials without a rule that its CSV file lacks, and return all of them."""
    # code compiled with other values of a kernel is kept apart from that of the user
    with tempfile.TemporaryDirectory() as cache:
        if name != WHOLE and RULES[name].assumed:
            os.environ["NUMBA_CACHE_DIR"] = cache
        file = folder / f"{name.replace(' ', '-')}.csv"
        rows = extended(file, tasks, begin=begin_without, words=(name,))
        os.environ.pop("NUMBA_CACHE_DIR", None)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rule", nargs="+", choices=RULES, metavar="RULE", default=[*RULES])
    parser.add_argument("--world", nargs="+", metavar="WORLD", help="by default, a rule's")
    parser.add_argument("--trials", type=int, default=6, help="of each world; 0: print only")
    parser.add_argument("--seed", type=int, default=20261128)
    parser.add_argument("--out", type=Path, default=Path("logs/rules"))
    options = parser.parse_args()
    print(f"Simulated. {describe_load()}.\n\n{PAIRS_HEAD}")
    for name in options.rule:
        print_progress(name)
        worlds = options.world or dict.fromkeys((*RULES[name].helps, *COMMON))
        tasks = [Task(options.seed, world, k) for world in worlds for k in range(options.trials)]
        whole, without = (trials_of(rule, tasks, options.out) for rule in (WHOLE, name))
        print("\n".join(pair_lines(name, whole, without)), flush=True)


if __name__ == "__main__":
    main()
