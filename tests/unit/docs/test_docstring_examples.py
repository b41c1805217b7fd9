"""Tests that docstring examples run, and that public functions describe all parameters."""

import ast
import doctest
import importlib
import inspect
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from testkit.paths import ROOT

import tetractl

ARGS = re.compile(r"^Args:\n((?: .*\n?)*)", re.MULTILINE)
"""The section `Args` of a docstring."""
ENTRY = re.compile(r"^ +\**(\w+)(?: \([^)]*\))?: ", re.MULTILINE)
"""The entry of a parameter in it."""
PAGE = ROOT / "docs" / "site" / "api.rst"
INTERFACES = (
    "tetractl.core.protocols:Optimizer",
    "tetractl.core.protocols:Controller",
    "tetractl.core.protocols:Observer",
    "tetractl.core.guard_check:GuardCheck",
)
"""Classes that plug-ins implement or derive from, each of which shows how."""


def api_functions() -> list[str]:
    """The names of all functions of `import tetractl`, in the order of the API reference.

    Examples read what those before them wrote.
    """
    return re.findall(r"autofunction:: tetractl\.(\w+)", PAGE.read_text())


def documented(docstring: str | None) -> list[str]:
    """The parameters that have an entry in the section `Args` of a docstring."""
    section = ARGS.search(inspect.cleandoc(docstring or ""))
    return ENTRY.findall(section[1]) if section else []


def examples(docstring: str | None) -> str:
    """The section `Example` of a docstring, empty if there is none."""
    found = re.search(r"^Example:\n((?: .*\n?|\n)*)", inspect.cleandoc(docstring or ""), re.M)
    return found[1] if found else ""


def run(text: str, names: dict[str, object], title: str) -> None:
    test = doctest.DocTestParser().get_doctest(text, names, title, None, 0)
    assert test.examples, f"{title}: its docstring has no example"
    report = list[str]()
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(test, out=report.append, clear_globs=False)
    assert not runner.failures, "".join(report)


@pytest.fixture
def work_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with a copy of the shipped specs, as the current folder."""
    shutil.copytree(ROOT / "experiments", tmp_path / "experiments")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.long
def test_the_example_of_each_function_of_the_api_prints_what_it_shows(work_folder: Path):
    for name in api_functions():
        function = getattr(tetractl, name)
        run(examples(function.__doc__), {"tetractl": tetractl, "Path": Path}, name)


@pytest.mark.parametrize("name", INTERFACES)
def test_each_interface_of_plug_ins_has_an_example_that_runs(name: str, work_folder: Path):
    module, _, attribute = name.partition(":")
    interface = getattr(importlib.import_module(module), attribute)
    run(examples(interface.__doc__), {"tetractl": tetractl}, name)


def undocumented(function: object) -> Iterator[str]:
    """Yield the parameters of a function that have no entry in its section `Args`."""
    assert inspect.isfunction(function)
    entries = documented(function.__doc__)
    for parameter in inspect.signature(function).parameters:
        if parameter not in ("self", "cls") and parameter not in entries:
            yield f"{function.__qualname__}: {parameter}"


def parameters_without_entry(tree: ast.AST) -> Iterator[str]:
    """Yield the parameters of a module's public functions that have three or more."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
            continue
        arguments = node.args
        names = [a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        names = [name for name in names if name not in ("self", "cls")]
        decorators = {getattr(decorator, "id", "") for decorator in node.decorator_list}
        if "Annotated[" in ast.unparse(arguments) or "Sets" in ast.unparse(arguments):
            continue  # a command: its options have their own help
        text = ast.get_docstring(node) or ""
        if len(names) < 3 or "overload" in decorators or not text:
            continue
        if "; see `" in text.partition("\n")[0]:  # overrides a method that describes them
            continue
        entries = documented(text)
        yield from (f"{node.name}: {name}" for name in names if name not in entries)


FOLDERS = sorted((ROOT / "tetractl").glob("*/")) + sorted((ROOT / "packages").glob("*/tetractl_*"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_functions_with_three_parameters_or_more_describe_each_of_them(folder: Path):
    missing = [
        f"{path.relative_to(ROOT)}: {line}"
        for path in sorted(folder.rglob("*.py"))
        for line in parameters_without_entry(ast.parse(path.read_text()))
    ]
    assert not missing


def test_each_parameter_of_the_api_has_an_entry():
    functions = [getattr(tetractl, name) for name in api_functions()]
    missing = [line for function in functions for line in undocumented(function)]
    assert not missing
