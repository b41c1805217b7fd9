"""Part (b): the error in closed loop, and the computing time of its steps."""

import numpy as np

from tetractl.core.trial import Result
from tetractl.spec.experiment import Experiment

from . import shooting
from .peers import available
from .problems import (
    LENGTH,
    OURS,
    PAPER,
    experiment,
    recommended,
    run,
)
from .report import Report, Settings, describe_load, format_spread, print_progress

HEAD = ["controller", "total error [mm], mean +- std", "worst [mm]", "entered obstacle"]
TIMES = ["first step [ms], median", "later steps [ms]"]


def _errors(name: str, results: list[Result]) -> list[str]:
    errors = np.array([r.total_error for r in results])
    std = errors.std(ddof=1) if len(errors) > 1 else 0.0
    entered = sum(r.entered_obstacle for r in results)
    mean = f"{errors.mean():.4g} +- {std:.3g}"
    return [name, mean, f"{errors.max():.4g}", f"{entered} of {len(results)}"]


def _times(results: list[Result]) -> list[str]:
    first = np.median([r.solve_ns[0] for r in results]) / 1e6
    later_s = np.concatenate([r.solve_ns[1:] for r in results]) / 1e9
    return [f"{first:.1f}", format_spread(later_s)]


def closed(settings: Settings) -> Report:
    """Measure the final error and step times on the undisturbed continuous plant."""
    report = Report("(b) Closed loop and control step")
    ours = experiment(OURS)
    contestants = [("paper, as published", experiment(PAPER)), ("**ours**", ours)]
    if available(shooting.PACKAGE):
        from tetractl_ipopt import Ipopt

        print_progress("(b) building the programmes of IPOPT")
        shooting.build_all(recommended(), LENGTH - 2 if settings.quick else 1)
        at_5hz = experiment(OURS, "controller.period=0.2")  # s: a signal a step
        ipopt = shooting.shrinking(at_5hz, Ipopt(type="ipopt"))
        if settings.quick:
            ipopt = replace_control(ipopt, time_limit=0.5)  # s: three steps
        contestants.append((f"CasADi + IPOPT, {LENGTH} signals, warm-started", ipopt))
    else:
        report.say("IPOPT: benchmarks/tetractl-ipopt is not installed: skipped.")
    rows = []
    for name, spec in contestants:
        print_progress(f"(b) closed loop: {name}")
        run(replace_control(spec, time_limit=0.1), 1)  # warm up
        results = run(spec, settings.trials)
        rows.append([*_errors(name, results), *_times(results)])
    report.say(
        f"{settings.trials} trials, continuous plant, nothing disturbed; times of steps are p50 / "
        f"p99 / max. {describe_load()}."
    )
    report.table([*HEAD, *TIMES], rows)
    return report


def replace_control(spec: Experiment, **fields: object) -> Experiment:
    return spec.model_copy(update={"controller": spec.controller.model_copy(update=fields)})
