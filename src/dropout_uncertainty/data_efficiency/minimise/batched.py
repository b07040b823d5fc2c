"""Many small minimisations at once: an optimiser per problem, their functions evaluated together as one batch.

Each problem runs its optimiser in a thread that does nothing but wait for function values, so all line
searches advance in step and the batch shrinks as problems finish. One problem takes the same path alone as
among many. Small problems are minimised by ``bfgs``, large ones by SciPy's L-BFGS-B.
"""

import math
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy import optimize
from torch import Tensor

from dropout_uncertainty.data_efficiency.minimise import bfgs

# Added to the best value where a function cannot be evaluated: high enough for a line search to turn back.
BARRIER = 1e6
# BFGS with a full matrix up to so many variables, L-BFGS-B above.
DENSE_UP_TO = 500
LIMITED: dict[str, Any] = {"maxcor": 20, "maxls": 30, "maxfun": 10**6, "ftol": 1e-10, "gtol": 1e-4}

Objective = Callable[[Float[Tensor, "A P"], list[int]], tuple[Float[Tensor, " A"], Float[Tensor, "A P"]]]


@dataclass(frozen=True)
class Minimum:
    """The outcome for each of B problems."""

    x: Float[Tensor, "B P"]
    value: Float[Tensor, " B"]  # NaN where the function could not be evaluated at the start
    iterations: Int[Tensor, " B"]  # line searches
    evaluations: Int[Tensor, " B"]
    failures: Int[Tensor, " B"]  # line searches that found no point good enough
    repairs: Int[Tensor, " B"]  # values that were not finite, from which the search turned back


def minimise(objective: Objective, start: Float[Tensor, "B P"], iterations: int, max_restarts: int = 2) -> Minimum:
    """Minimise B functions of P variables, at most ``iterations`` line searches each.

    Args:
        objective: returns values [A] and gradients [A, P] of the A problems whose numbers it is given as a
            list.
        start: where to begin.
        iterations: the limit on line searches.
        max_restarts: how often L-BFGS-B may begin anew after a failed line search.

    Raises:
        ValueError: if ``start`` has another number of axes.
    """
    if start.ndim != 2:
        raise ValueError(f"expected one start per problem, [B, P], got shape {tuple(start.shape)}")
    requests: queue.SimpleQueue = queue.SimpleQueue()
    points = start.detach().cpu().double().numpy()
    problems = [_Problem(i, x, iterations, max_restarts, requests) for i, x in enumerate(points)]
    for problem in problems:
        problem.start()
    active = set(range(len(problems)))
    try:
        while active:
            messages = sorted((requests.get() for _ in range(len(active))), key=lambda message: message[0])
            active -= {i for i, x in messages if x is None}
            waiting = [(i, x) for i, x in messages if x is not None]
            if waiting:
                _answer(problems, objective, waiting, start)
    finally:
        for i in active:  # an exception here must not leave threads waiting
            problems[i].answers.put(None)
        for problem in problems:
            problem.join()
    for problem in problems:
        if problem.error is not None:
            raise problem.error
    counts = {name: torch.tensor([getattr(p, name) for p in problems]) for name in _Problem.COUNTS}
    best = torch.from_numpy(np.stack([p.best for p in problems])).to(start)
    return Minimum(best, torch.tensor([p.value for p in problems], dtype=torch.float64), **counts)


def _answer(problems: list["_Problem"], objective: Objective, waiting: list, start: Tensor) -> None:
    numbers = [i for i, _ in waiting]
    values, gradients = objective(torch.from_numpy(np.stack([x for _, x in waiting])).to(start), numbers)
    plain = (x.detach().cpu().double().numpy() for x in (values, gradients))
    for i, value, gradient in zip(numbers, *plain, strict=True):
        problems[i].answers.put((float(value), gradient))


class _Problem(threading.Thread):
    """One problem's optimiser; asks for values through ``requests`` and waits for ``answers``."""

    COUNTS = ("iterations", "evaluations", "failures", "repairs")

    def __init__(self, number: int, x: np.ndarray, limit: int, max_restarts: int, requests: queue.SimpleQueue) -> None:
        super().__init__(daemon=True)
        self.number, self.limit, self.max_restarts = number, limit, max_restarts
        self.requests = requests
        self.answers: queue.SimpleQueue = queue.SimpleQueue()
        self.best, self.value = x, math.nan
        self.iterations = self.evaluations = self.failures = self.repairs = 0
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            self._minimise()
        except Exception as error:  # raised again by `minimise`, in the thread of its caller
            self.error = error
        self.requests.put((self.number, None))

    def _minimise(self) -> None:
        if len(self.best) <= DENSE_UP_TO:
            outcome = bfgs.minimise(self._ask, self.best, self.limit)
            self.iterations, self.failures = outcome.searches, outcome.failures
        else:
            self._minimise_limited()

    def _minimise_limited(self) -> None:
        while self.iterations < self.limit:
            options = {**LIMITED, "maxiter": self.limit - self.iterations}
            before = self.value
            outcome = optimize.minimize(self._ask_walled, self.best, jac=True, method="L-BFGS-B", options=options)
            self.iterations += outcome.nit
            # L-BFGS-B calls some failed line searches (status 2) converged; they end above the best point
            if math.isnan(self.value) or (outcome.status != 2 and outcome.fun <= self.value):
                return
            self.failures += 1
            if self.failures > self.max_restarts or self.value >= before:
                return

    def _ask(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return value and gradient, both NaN where one of them is not finite."""
        self.requests.put((self.number, x.copy()))
        answer = self.answers.get()
        if answer is None:
            raise RuntimeError("the batch was stopped")
        value, gradient = answer
        self.evaluations += 1
        if not (math.isfinite(value) and np.isfinite(gradient).all()):
            self.repairs += 1
            return math.nan, np.full_like(x, math.nan)
        if self.evaluations == 1 or value < self.value:
            self.best, self.value = x.copy(), value
        return value, gradient

    def _ask_walled(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return value and gradient; where they are not finite, a wall above the best value so far."""
        value, gradient = self._ask(x)
        if math.isfinite(value):
            return value, gradient
        return (0.0 if math.isnan(self.value) else self.value) + BARRIER, np.zeros_like(x)
