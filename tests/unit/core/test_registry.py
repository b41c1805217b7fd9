"""Tests of finding kinds by name: built-in, installed and broken ones."""

import pytest
from testkit.packages import install

from tetractl.core.registry import Kind, PluginError, Registry

BUILTIN = {"euler": "math:e", "pi": "math:pi"}
GROUP = "tetractl.numbers"


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def numbers(base=""):
    return Registry(GROUP, BUILTIN, base)


def points(*lines):
    return "\n".join([f"[{GROUP}]", *lines, ""])


def test_kinds_of_other_packages_follow_the_built_in_ones(site):
    install(site, "more-numbers", "1.2", points("tau = math:tau"))
    registry = numbers()
    assert registry.names() == ("euler", "pi", "tau")
    assert registry.kinds()[2] == Kind("tau", "math:tau", "more-numbers", "1.2")
    assert [str(kind) for kind in registry.kinds()] == [
        "euler",
        "pi",
        "tau (from more-numbers 1.2)",
    ]
    assert registry.load("tau") == pytest.approx(2 * registry.load("pi"))
    assert "tau" in registry
    assert "phi" not in registry


def test_a_name_that_is_built_in_stays_built_in(site):
    install(site, "bad-numbers", "1.0", points("pi = math:inf"))
    registry = numbers()
    assert registry.names() == ("euler", "pi")
    assert registry.kind("pi").package == ""
    assert registry.load("pi") == pytest.approx(3.14159, abs=1e-5)


def test_of_two_packages_with_one_name_the_first_in_the_alphabet_counts(site):
    install(site, "zeta", "1.0", points("tau = math:inf"))
    install(site, "alpha", "1.0", points("tau = math:tau"))
    assert numbers().kind("tau").package == "alpha"


@pytest.mark.parametrize(
    ("target", "code", "why"),
    [
        ("absent_module:x", "", "ModuleNotFoundError: No module named 'absent_module'"),
        ("broken_one:x", "import absent_module", "ModuleNotFoundError: No module named"),
        ("broken_one:x", "1 / 0", "ZeroDivisionError: division by zero"),
        ("broken_one:x", "x: (", "SyntaxError: '(' was never closed"),
        ("broken_one:x", "", "AttributeError: module 'broken_one' has no attribute 'x'"),
        ("broken_one:x", "x = 3", "the object is not a subclass of builtins:dict"),
        ("broken_one:x", "class x: pass", "the object is not a subclass of builtins:dict"),
    ],
)
def test_a_broken_package_is_named_with_its_entry_point(site, monkeypatch, target, code, why):
    monkeypatch.delitem(__import__("sys").modules, "broken_one", raising=False)
    install(site, "bad-numbers", "0.3", points(f"bad = {target}"), broken_one=code)
    registry = numbers("builtins:dict")
    with pytest.raises(PluginError) as raised:
        registry.load("bad")
    assert str(raised.value).startswith(f"bad-numbers 0.3: the number 'bad' cannot be used: {why}")
    assert "\n" not in raised.value.message
    assert f"'bad = {target} of {GROUP}'" in str(raised.value.hint)
    assert raised.value.exit == 2
    assert list(registry.load_usable()) == ["euler", "pi"]


def test_an_unknown_name_is_a_key_error():
    for look in (numbers().load, numbers().kind):
        with pytest.raises(KeyError):
            look("phi")


def test_a_class_of_the_right_base_is_loaded(site, monkeypatch):
    install(site, "good", "1.0", points("own = good_one:Own"), good_one="class Own(dict): pass")
    assert issubclass(numbers("builtins:dict").load("own"), dict)
