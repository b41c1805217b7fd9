"""`tetractl kinds`: lists the kinds that a spec, study, table, figure or emulated lab can name."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, option
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.core.table.table_files import json_text

if TYPE_CHECKING:
    from tetractl.core.registry import Kind


def kinds(
    check: Annotated[
        str | None,
        option(
            "MODULE:NAME",
            "Check your own motion, or section of a shape, optimiser, controller, disturbance, "
            "camera or actuator, given as module:NAME.",
        ),
    ] = None,
    spec: Annotated[
        Path | None,
        option("SPEC", "With --check: a spec whose robots, arena, obstacles and section are used."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        option("FIELD=VALUE", "With --check: set a field of the kind; may be repeated.", "--set"),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List every available kind: optimisers, shapes, cameras, sweeps, statistics, figures and so
    on.

    Each line names the interface, the `type`, and the package and the code that provide it, and
    what a kind needs that is not installed. Exits with 2 if an installed package is broken.

    With --check it tests a kind of your own: that its NumPy functions, compiled functions and
    derivatives agree, that its bounds hold, and that equal seeds give equal results. Exits with 1
    if something is wrong. Controllers and disturbances are tested in simulations. A camera is
    opened if possible. An actuator with a field `port` is opened on a fake port, and steered there;
    no robot moves.

    Example: tetractl kinds --check pivot:PIVOT
    """
    if check is None and (sets or spec):
        raise UsageError("--set and --spec need --check")
    return _list(as_json) if check is None else _check(check, spec, sets or [], as_json)


def _list(as_json: bool) -> int:
    from tetractl.core.registries import all_registries
    from tetractl.core.registry import PluginError
    from tetractl.experiment.packages import BRINGS, missing

    problems: dict[Kind, str] = {}
    broken: list[str] = []
    registries = all_registries()
    rows = [(registry, kind) for registry in registries for kind in registry.kinds()]
    for registry, kind in rows:
        try:
            registry.load(kind.name)
        except (PluginError, ModuleNotFoundError) as error:
            cause = error.__cause__ if isinstance(error, PluginError) else error
            module = cause.name or "" if isinstance(cause, ModuleNotFoundError) else ""
            lacks = module.partition(".")[0] not in ("", kind.code.partition(".")[0])
            if lacks and kind.package in ("", *BRINGS.values()):
                problems[kind] = f"needs {module}, which is not installed"
            else:  # of another's package, each problem is an error
                problems[kind] = error.message if isinstance(error, PluginError) else str(error)
                broken.append(problems[kind])
    if as_json:
        listed = [
            {
                "seam": registry.what,
                "type": kind.name,
                "package": kind.package or None,
                "version": kind.version or None,
                "code": kind.code,
                "problem": problems.get(kind),
            }
            for registry, kind in rows
        ]
        print(json_text({"kinds": listed}))
    else:
        for registry, kind in rows:
            package = f"{kind.package} {kind.version}" if kind.package else _home(kind)
            line = f"{registry.what:<17} {kind.name:<19} {package:<22} {kind.code}"
            print(f"{line}  [{problems[kind]}]" if kind in problems else line)
        for registry in registries:
            for name, package in sorted(missing(registry.group, registry.names())):
                print(f"{registry.what:<17} {name:<19} {package:<22} [not installed]")
        ui.tell(*(f"error: {problem}" for problem in broken))
    return Exit.USAGE if broken else Exit.DONE


def _home(kind: "Kind") -> str:
    top = kind.code.partition(".")[0]
    return "built in" if top == "tetractl" else f"built in {top.replace('_', '-')}"


def _check(code: str, spec: Path | None, sets: list[str], as_json: bool) -> int:
    from tetractl.cli.specs import template
    from tetractl.experiment.base import with_tuples
    from tetractl.experiment.load import parse_spec
    from tetractl.experiment.yaml.document import parse_value
    from tetractl.testing import check_kind

    sys.path.append("")  # modules in this folder, but in place of no other
    fields: dict[str, Any] = {}
    for setting in sets:
        name, equals, text = setting.partition("=")
        if not equals:
            raise UsageError(f"--set {setting}: must be FIELD=VALUE")
        fields[name] = with_tuples(parse_value(text, printable(f"--set {setting}"), (name,)))
    text = template("check", "check")
    loaded = parse_spec(text, "check") if spec is None else ui.load(spec, None)
    lab = loaded.experiment.lab if spec else None
    for section in (lab.camera, lab.actuator) if lab else ():
        if code == f"{type(section).__module__}:{type(section).__qualname__}":
            fields = dict(section) | fields
    found = list(check_kind(code, fields, loaded.experiment.setup))
    wrong = [finding for finding in found if finding.problem]
    if as_json:
        print(json_text({"code": code, "ok": not wrong, "findings": found}))
    else:
        for one in found:
            line = f"WRONG  {one.what}: {one.problem}" if one.problem else f"ok     {one.what}"
            print(printable(line))
        print(f"{code}: {len(wrong)} of {len(found)} checks failed")
    return Exit.FAILED if wrong else Exit.DONE
