"""BFGS: the original's sequence of values, and what happens where a function cannot be evaluated."""

import math

import numpy as np
import pytest

from dropout_uncertainty.data_efficiency.minimise import bfgs


def rosenbrock(x):
    rest = x[1:] - x[:-1] ** 2
    gradient = np.zeros_like(x)
    gradient[:-1] = -400 * x[:-1] * rest - 2 * (1 - x[:-1])
    gradient[1:] += 200 * rest
    return float((100 * rest**2 + (1 - x[:-1]) ** 2).sum()), gradient


@pytest.mark.parametrize("number", range(3))
def test_values_after_every_line_search_are_those_of_the_original(golden, number):
    case = golden("minimize")[number]
    start, evaluations = case["x0"].numpy().ravel(), int(case["MFEPLS"])
    searches = int(case["length"])
    ended = [bfgs.minimise(rosenbrock, start, n, evaluations) for n in range(1, searches + 1)]
    np.testing.assert_allclose([e.value for e in ended], case["fX"].numpy().ravel()[1:], rtol=1e-6)
    np.testing.assert_allclose(ended[-1].x, case["x"].numpy().ravel(), rtol=0, atol=1e-7)
    assert ended[-1].searches == searches


def test_no_search_begins_with_a_step_longer_than_one():
    visited = [np.full(3, 50.0)]

    def bowl(x):
        visited.append(x)
        return float(x @ x) / 2, x

    first = bfgs.minimise(bowl, visited[0], 1)
    assert np.linalg.norm(visited[2] - visited[1]) <= 1 + 1e-12
    assert first.value < bowl(visited[0])[0]


def test_ends_where_the_gradient_vanishes():
    found = bfgs.minimise(rosenbrock, np.array([-1.2, 1.0, 0.3]), 500)
    np.testing.assert_allclose(found.x, 1, atol=1e-4)
    assert found.searches < 100
    assert np.abs(found.gradient).max() <= 1e-4


def test_turns_back_from_where_the_function_cannot_be_evaluated():
    def walled(x):
        if x[0] > 1.5:
            return math.nan, np.full_like(x, math.nan)
        return float((x[0] - 1.4) ** 4), 4 * (x - 1.4) ** 3

    found = bfgs.minimise(walled, np.array([-3.0]), 100)
    assert found.value < 1e-4
    unknown = bfgs.minimise(walled, np.array([2.0]), 100)
    assert unknown.searches == 0
    assert unknown.x.tolist() == [2.0]


def test_two_failed_searches_in_a_row_end_it():
    values = iter(range(1000))

    def lying(x):
        return float(next(values)), np.ones_like(x)  # every value is higher than the last

    found = bfgs.minimise(lying, np.zeros(2), 10, evaluations=5)
    assert (found.searches, found.failures, found.value) == (2, 2, 0)
    assert found.x.tolist() == [0, 0]
