"""Tests that the controller `policy` passes the checks that every plug-in must pass."""

from base64 import b64encode
from typing import Any

import numpy as np
import pytest
from testkit.controller_promises import ControllerPromises
from testkit.trials import experiment
from tetractl_learn.policy import PolicySection
from tetractl_testing import check_controller

pytestmark = pytest.mark.slow


def straight(robots: int) -> dict[str, Any]:
    """A policy's layer: along the sum of the robots' gaps."""
    gaps = np.kron(np.ones(robots), np.eye(2))  # adds up x and y
    others = np.zeros((2, 2 * robots + 2))  # headings, and the last direction
    weights = np.hstack([gaps, others])
    biases = np.zeros(2)
    numbers = np.concatenate([weights.ravel(), biases])
    packed = b64encode(numbers.tobytes()).decode()
    return {"inputs": 4 * robots + 2, "outputs": 2, "numbers": packed}


FIELDS = {"type": "policy", "layers": [straight(3)]}


@pytest.fixture
def fields():
    return {"arrival_tolerance": 20} | FIELDS


class TestPolicy(ControllerPromises):
    """A policy for three robots."""


def test_it_passes_the_checks_of_plug_ins():
    check_controller(PolicySection.model_validate(FIELDS), experiment().setup)
