"""`tetractl kinds`: lists the kinds that a spec, study, table, figure or emulated lab can name."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, option
from tetractl.cli.specs import build_template
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.core.registries import KIND_CHECKS, all_registries
from tetractl.core.registry import PluginError
from tetractl.spec.packages import PROVIDERS, explain_missing, list_missing
from tetractl.tools.table.table_files import format_json

if TYPE_CHECKING:
    from tetractl.core.registry import Kind, Registry
    from tetractl.core.setup import Setup
    from tetractl.spec.experiment import Experiment


def kinds(
    check: Annotated[
        str | None,
        option(
            "MODULE:NAME",
            "Check a class or object of your own: a motion, or the section of a shape, optimiser, "
            "controller, disturbance, camera or actuator. NAME is its name in MODULE.",
        ),
    ] = None,
    spec: Annotated[
        Path | None,
        option(
            "SPEC", "Spec whose robots, arena, obstacles and section the checks use. Needs --check."
        ),
    ] = None,
    sets: Annotated[
        list[str] | None,
        option(
            "FIELD=VALUE",
            "Set a field of the class that --check names. Needs --check. Can be repeated.",
            "--set",
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List all kinds: optimisers, shapes, cameras, sweeps, statistics, figures and so on.

    Each line names the interface, the `type`, and the package and code that provide it. If a kind
    needs a package that is not installed, the line also names this package. Exits with 2 if an
    installed package is broken.

    With --check, the command tests a kind of your own. It tests whether NumPy functions, compiled
    functions and derivatives agree, whether the bounds hold, and whether equal seeds give equal
    results. Exits with 1 if something is wrong. Controllers and disturbances are tested in
    simulations. A camera is opened if possible. An actuator with a field `port` is opened on a fake
    port, and steered there; no robot moves.

    Example: tetractl kinds --check pivot:PIVOT
    """
    if check is None and (sets or spec):
        raise UsageError("--set and --spec can be used only together with --check")
    return _list_kinds(as_json) if check is None else _check_kind(check, spec, sets or [], as_json)


@dataclass(frozen=True, slots=True)
class _ListedKind:
    """A line of the list: a kind of a registry, and the problem that prevents its use.

    Attributes:
        registry: The registry of the kind.
        kind: The kind.
        lacks: Name of a module that the kind needs and that is not installed. Empty if none.
        broken: The reason why an installed kind cannot be used at all. Empty if it can be used.
    """

    registry: "Registry"
    kind: "Kind"
    lacks: str = ""
    broken: str = ""

    @property
    def problem(self) -> str:
        """The problem that prevents the use of the kind, in words. Empty if there is none."""
        return f"needs {self.lacks}, which is not installed" if self.lacks else self.broken


def _list_kinds(as_json: bool) -> int:
    """Print the list of all kinds, and return the exit code."""

    registries = all_registries()
    listed = [_load_kind(registry, kind) for registry in registries for kind in registry.kinds()]
    broken = [row.broken for row in listed if row.broken]
    if as_json:
        print(format_json({"kinds": [_convert_to_item(row) for row in listed]}))
    else:
        for row in listed:
            print(_format_line(row))
        for registry in registries:
            for name, package in sorted(list_missing(registry.group, registry.names())):
                print(_format_columns(registry, name, package, "[not installed]"))
        ui.print_messages(*(f"error: {problem}" for problem in broken))
    return Exit.USAGE if broken else Exit.DONE


def _load_kind(registry: "Registry", kind: "Kind") -> _ListedKind:
    """Load the code of a kind, and return the kind with its problem, if it has one.

    A module that is not installed is no error for a kind of tetractl's own packages. For a kind of
    another package, every problem is an error.
    """

    try:
        registry.load(kind.name)
    except (PluginError, ModuleNotFoundError) as error:
        cause = error if isinstance(error, ModuleNotFoundError) else error.__cause__
        module = cause.name or "" if isinstance(cause, ModuleNotFoundError) else ""
        is_other_package = module.partition(".")[0] not in ("", kind.code.partition(".")[0])
        if is_other_package and kind.package in ("", *PROVIDERS.values()):
            return _ListedKind(registry, kind, lacks=module)
        message = error.message if isinstance(error, PluginError) else str(error)
        return _ListedKind(registry, kind, broken=message)
    return _ListedKind(registry, kind)


def _convert_to_item(row: _ListedKind) -> dict[str, str | None]:
    """Return a kind as data for the JSON output."""
    kind = row.kind
    return {
        "seam": row.registry.what,
        "type": kind.name,
        "package": kind.package or None,
        "version": kind.version or None,
        "code": kind.code,
        "problem": row.problem or None,
    }


def _format_line(row: _ListedKind) -> str:
    """Return a kind as a line of the printed list."""
    kind = row.kind
    package = f"{kind.package} {kind.version}" if kind.package else _name_own_package(kind)
    line = _format_columns(row.registry, kind.name, package, kind.code)
    return f"{line}  [{row.problem}]" if row.problem else line


def _format_columns(registry: "Registry", name: str, package: str, columns: str) -> str:
    return f"{registry.what:<17} {name:<19} {package:<22} {columns}"


def _name_own_package(kind: "Kind") -> str:
    """Return the package of a kind that names none: tetractl, or one of its own packages."""
    top = kind.code.partition(".")[0]
    return "built in" if top == "tetractl" else f"built in {top.replace('_', '-')}"


# ---- --check ----


def _load_kind_check() -> Callable[[str, Mapping[str, Any], "Setup"], Sequence[Any]]:
    """Return the function that checks a motion, camera or other kind that a user has written.

    Raises:
        UsageError: If no installed package brings it.
    """
    if "kind" not in KIND_CHECKS:
        explanation = explain_missing(KIND_CHECKS.group, "kind")
        assert explanation is not None
        message, hint = explanation
        raise UsageError(f"--check: {message}", hint)
    return KIND_CHECKS.load("kind")


def _check_kind(code: str, spec: Path | None, sets: list[str], as_json: bool) -> int:
    """Check the kind that `code` names, print each finding, and return the exit code."""
    check_kind = _load_kind_check()
    sys.path.append("")  # modules in this folder, but in place of no other
    fields = _parse_fields(sets)
    experiment = _load_experiment(spec)
    if spec is not None:
        fields = _read_lab_fields(experiment, code) | fields
    findings = check_kind(code, fields, experiment.setup)
    failed = [finding for finding in findings if finding.problem]
    if as_json:
        print(format_json({"code": code, "ok": not failed, "findings": findings}))
    else:
        for finding in findings:
            if finding.problem:
                line = f"WRONG  {finding.what}: {finding.problem}"
            else:
                line = f"ok     {finding.what}"
            print(printable(line))
        print(f"{code}: {len(failed)} of {len(findings)} checks failed")
    return Exit.FAILED if failed else Exit.DONE


def _parse_fields(sets: list[str]) -> dict[str, Any]:
    """Return the fields of a kind that --set gives, by name."""
    from tetractl.spec.base import with_tuples
    from tetractl.spec.yaml.document import parse_value

    fields: dict[str, Any] = {}
    for setting in sets:
        name, equals, value_text = setting.partition("=")
        if not name or not equals:
            raise UsageError(f"--set {setting}: write it as FIELD=VALUE")
        fields[name] = with_tuples(parse_value(value_text, printable(f"--set {setting}"), (name,)))
    return fields


def _load_experiment(spec: Path | None) -> "Experiment":
    """Return the experiment whose robots and arena a check uses: a spec's, or that of `init`."""
    from tetractl.spec.load import parse_spec

    if spec is not None:
        return ui.load_spec_file(spec, None).experiment
    return parse_spec(build_template("check", "check"), "check").experiment


def _read_lab_fields(experiment: "Experiment", code: str) -> dict[str, Any]:
    """Return the fields of the lab's camera or actuator if `code` names its kind, or none."""
    lab = experiment.lab
    if lab is not None:
        for section in (lab.camera, lab.actuator):
            if code == f"{type(section).__module__}:{type(section).__qualname__}":
                return dict(section)
    return {}
