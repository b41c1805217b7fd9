"""Tests that loading any file gives an experiment, or one line for each problem."""

import copy

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from testkit.paths import ROOT
from testkit.targets import spec_text

from tetractl.spec.experiment import Experiment
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import resolved_yaml, spec_hash
from tetractl.spec.yaml.core_yaml import format_yaml
from tetractl.spec.yaml.document import parse_document

pytestmark = pytest.mark.slow

WRITTEN = (ROOT / "experiments" / "three_m3pi.yaml").read_text("utf-8")
DATA = parse_document(WRITTEN, "three_m3pi.yaml").data

WORDS = ["paper", "relative", "circle", "sim", "mpc", "stand", "mm", "green"]
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(WORDS),
)
KEYS = st.text(max_size=8) | st.sampled_from(
    ["type", "name", "robots", "arena", "start", "target", "a", "controller", "swarm", "stop", "0"]
)
TREES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=5),
    max_leaves=15,
)


def keys_of(holder):
    """The keys of a mapping or the indices of a list."""
    if isinstance(holder, dict):
        return list(holder)
    return list(range(len(holder)))


def some_value(draw, data):
    """A mapping or list somewhere in the data and one of its keys; None for the key if it is empty.

    The way down ends at a value that holds no others, and at any other as often as not.
    """
    holder = data
    while keys_of(holder):
        key = draw(st.sampled_from(keys_of(holder)))
        value = holder[key]
        if not isinstance(value, dict | list) or draw(st.booleans()):
            return holder, key
        holder = value
    return holder, None


@st.composite
def mutated(draw):
    """Return the data of a good spec with some values replaced or dropped."""
    data = copy.deepcopy(DATA)
    for _ in range(draw(st.integers(1, 3))):
        holder, key = some_value(draw, data)
        if key is None:
            continue
        if draw(st.booleans()):
            holder[key] = draw(TREES)
        else:
            del holder[key]
    return data


@pytest.mark.long
@given(mutated())
def test_any_change_to_a_good_spec(data):
    spec_text(format_yaml(data))


NUMBERS = st.floats(-1e6, 1e6)
POSITIVE = st.floats(1e-6, 1e6)
PERIODS = st.floats(1e-3, 500)  # longer ones have too many samples to simulate
INSIDE = st.tuples(st.floats(0, 100), st.floats(0, 100))
STOPS = st.sampled_from([{"type": "paper"}, {"type": "relative"}, {"type": "target", "cost": 1e-5}])


@st.composite
def experiments(draw):
    names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,9}", fullmatch=True)
    robots = [
        {
            "name": name,
            "start": draw(INSIDE),
            "heading": draw(NUMBERS),
            "target": draw(INSIDE),
            "a": draw(POSITIVE),
            "speed": draw(POSITIVE),
        }
        for name in draw(st.lists(names, min_size=1, max_size=4, unique=True))
    ]
    return Experiment.model_validate(
        {
            "name": draw(st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,9}", fullmatch=True)),
            "description": draw(st.text() | st.sampled_from(["1e3", "on", "0o7", "12:30", "~"])),
            "arena": {"left": 0, "bottom": 0, "width": 100, "height": 100},
            "robots": robots,
            "controller": {
                "type": "pso-mpc",
                "period": draw(PERIODS),
                "optimizer": {"stop": draw(STOPS)},
            },
            "trials": {"seed": draw(st.integers(0, 2**64 - 1))},
        }
    )


GOOD = parse_spec(WRITTEN, "s.yaml").experiment
NEGATIVE_ZERO = GOOD.model_copy(
    update={"robots": (GOOD.robots[0].model_copy(update={"heading": -0.0}),)}
)


@pytest.mark.long
@given(experiments())
@example(NEGATIVE_ZERO)
def test_a_resolved_spec_loads_as_the_same_experiment(experiment):
    loaded = parse_spec(resolved_yaml(experiment), "resolved").experiment
    assert loaded == experiment
    assert spec_hash(loaded) == spec_hash(experiment)
