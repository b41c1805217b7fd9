"""The commands `tetractl init`, `validate`, `warm` and `schema`, which write or check specs.

A spec is the YAML file that describes an experiment. None of these commands runs a trial.
"""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Sets, Strict, argument, option, out_option, switch
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.core.registries import EXAMPLES
from tetractl.spec.packages import explain_missing
from tetractl.spec.yaml.problems import InvalidSpecError, suggest_similar
from tetractl.tools.table.table_files import format_json
from tetractl.tools.table.terminal_table import open_console

if TYPE_CHECKING:
    from tetractl.run.plausibility import PlacedWarning
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.loaded_spec import LoadedSpec

FILE_FIELDS = ("base", "identified")
"""Fields of a spec that name another file, relative to the spec's folder."""
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def read_example_files(name: str) -> dict[str, str]:
    """Return an example and the files it names, keyed by their path in the examples' folder.

    Raises UsageError if there is no such example, or its package is not installed.
    """
    from tetractl.spec.examples import FOLDER, find_examples
    from tetractl.spec.yaml.document import parse_document
    from tetractl.spec.yaml.spec_files import read_text

    files = find_examples()
    name = name.removesuffix(".yaml").removeprefix(f"{FOLDER}/")
    if name not in files:
        raise _create_example_error(name, list(files))
    example_at = {file.resolve(): example for example, file in files.items()}
    text_by_path: dict[str, str] = {}
    unread = [name]
    while unread:
        example = unread.pop()
        if f"{example}.yaml" in text_by_path:
            continue
        file = files[example].resolve()
        text = read_text(file)
        text_by_path[f"{example}.yaml"] = text
        fields = parse_document(text, str(file)).data
        named_files = [file.parent / fields[key] for key in FILE_FIELDS if key in fields]
        unread += [example_at[named.resolve()] for named in named_files]
    return text_by_path


def _create_example_error(name: str, examples: Sequence[str]) -> UsageError:
    """Return the error for an unknown example. It lists examples, or the package to install."""

    folders = sorted({f"{example.partition('/')[0]}/" for example in examples if "/" in example})
    group = name.partition("/")[0]
    install_advice = explain_missing(EXAMPLES.group, group)
    if install_advice and f"{group}/" not in folders:
        problem, hint = install_advice
        return UsageError(f"the example '{name}' {problem}", hint)
    ungrouped = [example for example in examples if "/" not in example]
    return UsageError(
        f"there is no example named '{name}'{suggest_similar(name, examples)}",
        f"the available examples are {', '.join([*ungrouped, *folders])}",
    )


def init(
    name: Annotated[
        str | None,
        argument("[NAME]", "Name of the experiment and of the file to write. [experiment]"),
    ] = None,
    lab: Annotated[bool, switch("Add a lab to the spec.", "--lab")] = False,
    camera: Annotated[
        str | None,
        option("KIND", "The lab's camera, such as apriltag. [optitrack; for toio robots toio]"),
    ] = None,
    robots: Annotated[
        str | None, option("KIND", "The lab's robots, such as twist. [m3pi-xbee]")
    ] = None,
    example: Annotated[
        str | None,
        option("NAME", "Write this example, such as three_m3pi, to experiments/three_m3pi.yaml."),
    ] = None,
) -> int:
    """Write NAME.yaml, a commented spec that can be run. An existing file is left unchanged.

    With --example, the command writes a shipped spec, study or fault script, and the files that it
    names, to experiments/, where the examples of other commands expect it. If there is no such
    example, the command lists all examples of tetractl and of the installed packages. For folders
    such as studies/, it lists only the folder itself.

    Example: tetractl init first

    Example: tetractl init shelf --lab --camera apriltag --robots twist

    Example: tetractl init --example studies/dead_time
    """
    if example is not None:
        if name is not None or lab or camera or robots:
            raise UsageError(
                "--example writes a file exactly as shipped, and cannot be combined with "
                "other options",
                "give --example alone",
            )
        return _write_example(example)
    if (camera or robots) and not lab:
        raise UsageError("--camera and --robots describe a lab, which needs --lab", "add --lab")
    name = "experiment" if name is None else name
    path = Path(name if re.search(r"\.ya?ml$", name) else f"{name}.yaml")
    if not NAME_PATTERN.fullmatch(path.stem):
        raise UsageError(
            f"'{printable(name, 80)}' cannot be the name of an experiment",
            "use up to 64 characters: a to z, A to Z, 0 to 9, dot, underscore and hyphen",
        )
    _write_new_file(
        path, build_template(path.stem, path.name, lab, camera, robots), "give another NAME"
    )
    ui.print_messages(f"run it with: tetractl run {path}")
    return Exit.DONE


def _write_example(name: str) -> int:
    from tetractl.spec.examples import FOLDER

    files = read_example_files(name)
    for relative_path in files:
        (Path(FOLDER) / relative_path).parent.mkdir(parents=True, exist_ok=True)
    for number, (relative_path, text) in enumerate(files.items()):
        path = Path(FOLDER) / relative_path
        if number and path.exists():  # the file was written with another example
            continue
        _write_new_file(path, text, "rename the existing file, or edit it")
    return Exit.DONE


def _write_new_file(path: Path, text: str, hint: str) -> None:
    """Write a file that must not exist yet, and print its name."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{path}: exists already", hint) from None
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None
    print(path)


def build_template(
    name: str, file: str, lab: bool = False, camera: str | None = None, robots: str | None = None
) -> str:
    """Return the text of a commented spec that can be run, as `tetractl init` writes it.

    Args:
        name: Name of the experiment.
        file: File that the spec will be in.
        lab: Whether it has a lab.
        camera: Kind of the lab's camera. None for the default.
        robots: Kind of the lab's robots. None for the default.
    """
    from tetractl.spec.lab_template import OWN_TEMPLATES, lab_template
    from tetractl.spec.yaml.core_yaml import format_yaml

    if lab:
        text = lab_template(robots or "m3pi-xbee", camera)
    else:
        text = (OWN_TEMPLATES / "robots.yaml").read_text("utf-8")
    name_line = format_yaml({"name": name}).strip(
        "{}\n"
    )  # in quotes if YAML would read the name as a number
    return text.replace("@NAME@", name_line).replace("@FILE@", file)


def validate(
    specs: Annotated[
        list[Path],
        argument(
            "SPEC|STUDY",
            "Files to check. For a study, the command also checks the spec of each arm.",
        ),
    ],
    sets: Annotated[
        list[str] | None,
        option("PATH=VALUE", "Replace a value of every spec before the check.", "--set"),
    ] = None,
    strict: Strict = False,
    as_json: AsJson = False,
) -> int:
    """Check specs and studies, and report every problem at its line.

    If a valid value will probably not work as intended, the command prints a warning on stderr.

    Example: tetractl validate experiments/*.yaml
    """
    checked = [_check_file(spec, sets or []) for spec in specs]
    if as_json:
        print(format_json({"specs": [spec.fields for spec in checked]}))
    else:
        for spec in checked:
            print("\n".join(spec.lines))
    all_ok = all(spec.fields["ok"] for spec in checked)
    doubtful = any(spec.fields.get("warnings") for spec in checked)
    return Exit.USAGE if not all_ok or (strict and doubtful) else Exit.DONE


@dataclass(frozen=True, slots=True)
class CheckedFile:
    """The findings about a file that was checked: as items for JSON, and as lines of text."""

    fields: dict[str, Any]
    lines: list[str]


def _check_file(path: Path, sets: list[str]) -> CheckedFile:
    """Check a spec, or a study and the specs of its arms, and print the warnings."""
    from tetractl.spec.load import is_study, load_document
    from tetractl.spec.yaml.document import read_document

    file = printable(str(path))
    try:
        document = read_document(path)
        if is_study(document):
            return _check_study(path, sets, file)
        loaded = load_document(document, sets)
    except InvalidSpecError as error:
        problems = [asdict(problem) for problem in error.problems]
        return CheckedFile({"path": file, "ok": False, "problems": problems}, error.lines())
    return _summarise_valid(file, loaded, ui.print_warnings(loaded))


def _summarise_valid(
    file: str, loaded: "LoadedSpec", warnings: "Sequence[PlacedWarning]"
) -> CheckedFile:
    """Return the findings about a valid spec."""
    from tetractl.model.bounds import compute_min_total_error
    from tetractl.reach.reach import reach

    experiment = loaded.experiment
    setup = experiment.setup
    summary = {
        "name": experiment.name,
        "robots": len(experiment.robots),
        "obstacles": len(experiment.obstacles),
        "controller": experiment.controller.type,
        "plant": experiment.plant.type,
        "trials": experiment.trials.count,
    }
    counts = ", ".join(f"{key} {value}" for key, value in summary.items())
    line = f"{file}: ok: {counts}"
    reached = reach(experiment)
    if reached:
        line += f", reach {reached}"
    fields = {
        "path": file,
        "ok": True,
        **summary,
        "hash": loaded.hash,
        "warnings": [asdict(warning) for warning in warnings],
        "least_total_error": compute_min_total_error(setup, setup.time_limit_s),
        "reach": reached.fields if reached else None,
    }
    return CheckedFile(fields, [line])


def _check_study(path: Path, sets: list[str], file: str) -> CheckedFile:
    """Check a study and the spec of each arm. Each warning is printed once."""
    from tetractl.run.plausibility import find_warnings
    from tetractl.study.load_study import load_study

    loaded = load_study(path, sets)
    name = loaded.study.name
    arms = len(loaded.arms)
    trials = loaded.arms[0].spec.experiment.trials.count
    warnings = {str(warning): warning for arm in loaded.arms for warning in find_warnings(arm.spec)}
    ui.print_messages(*(f"warning: {warning_text}" for warning_text in warnings))
    fields = {
        "path": file,
        "ok": True,
        "name": name,
        "arms": arms,
        "trials": trials,
        "warnings": [asdict(warning) for warning in warnings.values()],
    }
    line = f"{file}: ok: study {name}, arms {arms}, trials {trials} each"
    return CheckedFile(fields, [line])


def warm(
    specs: Annotated[
        list[Path] | None,
        argument(
            "[SPEC|STUDY]...",
            "Specs and studies to compile for. [the spec that `tetractl init` writes]",
        ),
    ] = None,
    sets: Sets = None,
    verbose: Annotated[
        bool, switch("Also print how long the compilation of each function took.", "--verbose")
    ] = False,
) -> int:
    """Compile the code that specs and studies need, so that runs start at once.

    Compiled code is kept on this machine, for each kind of processor and each combination of
    controller, optimiser and motion. Run this command again after a change of one of these.

    Example: tetractl warm three-m3pi.yaml studies/slip.yaml
    """
    from tetractl.control.methods.build import compiled_for, warm_up
    from tetractl.tools.cache import cache_folder

    by_kernel: dict[str, list[Experiment]] = {}
    for experiment in _load_experiments(specs or [], sets or []):
        by_kernel.setdefault(compiled_for(experiment), []).append(experiment)
    console = open_console(stderr=True)
    for number, (kernel_kinds, experiments) in enumerate(by_kernel.items(), start=1):
        began_s = perf_counter()
        with console.status(f"{number} of {len(by_kernel)}: compiling for {kernel_kinds}"):
            for experiment in experiments:  # the first spec compiles most of the code
                warm_up(experiment, lambda text: None)
        print(f"{kernel_kinds}: {perf_counter() - began_s:.1f} s", flush=True)
    if verbose:
        _print_compile_times()
    ui.print_messages(f"kept in {cache_folder()}")
    return Exit.DONE


def _print_compile_times() -> None:
    """Print which functions were compiled, with their times, the slowest first."""
    from tetractl.tools.kernels.kernel_cache import compile_times

    times = sorted(compile_times().items(), key=lambda item: -item[1].own_s)
    total_s = sum(compile_time.own_s for _, compile_time in times)
    versions = sum(compile_time.versions for _, compile_time in times)
    print(f"{versions} functions compiled in {total_s:.1f} s of processor time")
    print("seconds  signatures  function, without those that it calls")
    for name, compile_time in times:
        print(f"{compile_time.own_s:7.2f}  {compile_time.versions:10d}  {name}")


def _load_experiments(paths: list[Path], sets: list[str]) -> "Iterator[Experiment]":
    """Yield the experiments for which `tetractl warm` compiles code.

    They are the specs, one arm for each controller of each study or, without files, the spec that
    `tetractl init` writes.
    """
    from tetractl.spec.load import is_study, load_document, parse_spec
    from tetractl.spec.yaml.document import read_document
    from tetractl.study.load_study import load_study

    if not paths:
        yield parse_spec(build_template("warm", "warm"), "warm", sets).experiment
    for file in paths:
        document = read_document(file)
        if is_study(document):
            arms = load_study(file, sets).arms
            yield from {arm.controller: arm.spec.experiment for arm in arms}.values()
        else:
            yield load_document(document, sets).experiment


def schema(
    out: Annotated[Path | None, out_option("FILE", "File to write the schema to.")] = None,
    study: Annotated[
        bool, switch("Print the schema of a study instead of a spec.", "--study")
    ] = False,
) -> None:
    """Print the JSON schema of a spec, or of a study, for editors.

    Example: tetractl schema -o experiment.schema.json
    """
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.schema import schema_of
    from tetractl.study.load_study import Study

    contents = schema_of(Study if study else Experiment)
    text = json.dumps(contents, indent=2, ensure_ascii=False) + "\n"
    if out is None:
        print(text, end="")
    else:
        out.write_text(text, encoding="utf-8")
