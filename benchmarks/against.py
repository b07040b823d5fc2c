"""CPU time of this tree beside that of an older commit, side by side in one run.

    python benchmarks/against.py COMMIT [--quick] [--only WORDS] [--pairs N]
    python benchmarks/against.py --profile [--quick] [--only WORDS]

The commit is checked out into a temporary worktree. For each piece of work two processes of one thread, one per tree,
do the same in turns, so that whatever else the machine does falls on both; the table has the medians over the pairs and
the median of the ratios with its quartiles. The peak memory is that of the process, Python and torch included.
With --profile: where the time of this tree goes.
"""

import argparse
import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

ROOT = Path(__file__).resolve().parents[1]
SEEDS = tuple(range(100, 120))
Work = tuple[Callable[[], object], float]  # what is timed, and by how much its seconds are divided


def module(*names: str) -> ModuleType:
    """Return the first of the package's modules that this tree has: modules have moved."""
    for name in names:
        with contextlib.suppress(ModuleNotFoundError):
            return import_module(f"dropout_uncertainty.{name}")
    raise ModuleNotFoundError(f"this commit has none of the modules {', '.join(names)}")


def deep_pilco(quick: bool) -> Work:
    """Return one trial of `OURS` after another, 20 repetitions together: seconds per repetition and trial."""
    learner = module("data_efficiency.deep_pilco.learner", "data_efficiency.deep_pilco_experiment")
    config = learner.OURS
    if quick:  # a tenth of the steps, without redraws, which would have another share
        steps = {"model_steps": config.model_steps // 10, "policy_steps": config.policy_steps // 10}
        config = replace(config, **steps, guard=1.0)
    process = learner.start(config, SEEDS)
    process.advance()  # the random trial
    return process.advance, len(SEEDS)


def policy_search(quick: bool) -> Work:
    """Return ten steps of Adam on the policies of `deep_pilco`: seconds per repetition and step."""
    learner = module("data_efficiency.deep_pilco.learner", "data_efficiency.deep_pilco_experiment")
    planning = module("data_efficiency.deep_pilco.planning", "data_efficiency.deep_pilco")
    config = replace(learner.OURS, policy_steps=10)
    process = learner.start(config, SEEDS)
    args = process.model, config.plant, process.shape, config, process.policy, 0
    return lambda: planning.improve(*args), len(SEEDS) * config.policy_steps


def network(quick: bool) -> Work:
    """Return twenty steps of Adam on the networks of `deep_pilco`, 1000 transitions: seconds per repetition, step."""
    torch = import_module("torch")
    learner = module("data_efficiency.deep_pilco.learner", "data_efficiency.deep_pilco_experiment")
    config, model = learner.OURS, learner.start(learner.OURS, SEEDS).model
    g = module("rng").generator(100, "benchmark")
    inputs, targets = torch.randn(len(SEEDS), 1000, 6, generator=g), torch.randn(len(SEEDS), 1000, 4, generator=g)
    options = {"rate": 1e-3, "final_rate": 1.0, "batch": config.batch, "length_scale": config.length_scale}
    return lambda: model.fit(inputs, targets, 0, steps=20, **options), len(SEEDS) * 20


def gaussian_process(replicas: int, count: int) -> tuple[ModuleType, Any]:
    """Return the module of the Gaussian process, and one whose parameters have not been fitted."""
    torch = import_module("torch")
    gaussian = module("data_efficiency.pilco.gaussian_process", "data_efficiency.gaussian_process")
    g = module("rng").generator(100, "benchmark")
    x = torch.randn(replicas, count, 6, generator=g, dtype=torch.float64)
    y = 0.1 * torch.sin(x @ torch.randn(6, 4, generator=g, dtype=torch.float64) / 6**0.5).mT
    y = y + 0.01 * torch.randn(y.shape, generator=g, dtype=torch.float64)
    return gaussian, gaussian.GaussianProcess(x, y, gaussian.initial_hyper(x, y))


def likelihood(inducing: int) -> Callable[[bool], Work]:
    """Return a line search of ten repetitions with 560 transitions, of inducing inputs if there are some: seconds."""

    def make(quick: bool) -> Work:
        gaussian, model = gaussian_process(10, 560)
        if inducing:
            return lambda: gaussian.fit_inducing(model, model.inputs[:, :inducing], 1), 10
        return lambda: gaussian.fit_hyper(model.inputs, model.targets, model.log_hyper, 1), 10

    return make


def pilco(count: int) -> Callable[[bool], Work]:
    """Return PILCO's objective with gradient, one replica and ``count`` transitions: seconds."""

    def make(quick: bool) -> Work:
        planning = module("data_efficiency.pilco.planning", "data_efficiency.pilco")
        plant = module("data_efficiency.plant.cartpole", "data_efficiency.cartpole").MATLAB
        model, _ = gaussian_process(1, count)[1].posterior()
        shape = planning.PolicyShape(10)
        policy = shape.initial(plant, 0.1, (0.0, 0.0, 0.0, -0.36, -0.36), module("rng").generator(100, "policy"))[None]
        return lambda: planning.objective(model, plant, shape, policy), 1

    return make


def environment(quick: bool) -> Work:
    """Return steps of the Gymnasium environment: seconds per step."""
    np = import_module("numpy")
    name = "data_efficiency.plant.environment", "data_efficiency.gymnasium_env"
    env, action, steps = module(*name).CartPoleSwingUp(), np.array([0.3], dtype=np.float32), 20

    def work() -> None:
        env.reset(seed=100)
        for _ in range(steps):
            env.step(action)

    return work, steps


def foraging(quick: bool) -> Work:
    """Return ticks of two agents that learn from full memories, ten replicas: seconds per tick of a replica."""
    experiment = module("exploration.experiment")
    made = experiment.start(experiment.CONFIGS["as-demo"], range(100, 110), device="cpu")
    for agent in made.agents:
        agent.memory.memory.uniform_(generator=module("rng").generator(100, "benchmark"))
        agent.memory.stored = agent.memory.capacity
    made.advance()
    return made.advance, 10 * experiment.BLOCK


def cnn(part: str) -> Callable[[bool], Work]:
    """Return training on 100 labels, the test error, or scoring of 500 points: seconds.

    In bfloat16, or in float32 where the CPU has no instructions for it and would take ten times as long.
    """

    def make(quick: bool) -> Work:
        torch = import_module("torch")
        experiment = module("active_learning.experiment")
        config = replace(experiment.CONFIGS["ours/dropout/bald"], epochs=5 if quick else 50)
        has_bfloat16 = torch.backends.cpu.get_cpu_capability() not in ("DEFAULT", "AVX2")
        learner = experiment.CNNLearner(config, [100], precision="bfloat16" if has_bfloat16 else "float32")
        learner.fit(torch.arange(100)[None])
        works = {
            "train": lambda: learner.fit(torch.arange(100)[None]),
            "test": learner.test_error,
            "score": lambda: learner.log_probs(torch.arange(10_000, 10_500)[None], 100),
        }
        return works[part], 1

    return make


#: Name, whose unit is in the description, and how it is made.
WORKS: dict[str, Callable[[bool], Work]] = {
    "Deep PILCO: a trial, 20 together, per repetition": deep_pilco,
    "Deep PILCO: a step of the policy search, per repetition": policy_search,
    "Deep PILCO: a step of the network, per repetition": network,
    **{f"PILCO: objective with gradient, N = {n}": pilco(n) for n in (40, 200, 400)},
    "PILCO: a line search of the hyper-parameters, N = 560, per repetition of 10": likelihood(0),
    "PILCO: a line search of 300 inducing inputs, N = 560, per repetition of 10": likelihood(300),
    "Gymnasium: a step of the environment": environment,
    "2D world: a tick, two agents learning, per replica of 10": foraging,
    "CNN: training on 100 labels": cnn("train"),
    "CNN: test error": cnn("test"),
    "CNN: scoring 500 points": cnn("score"),
}


def serve(name: str, quick: bool) -> None:
    """Do a piece of work once for each line that comes in; answer with seconds and peak memory [MiB]."""
    import_module("torch").set_num_threads(1)
    work, share = WORKS[name](quick)
    for _ in sys.stdin:
        begun = time.process_time()
        work()
        seconds = (time.process_time() - begun) / share
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        print(json.dumps([seconds, peak]), flush=True)


def profile(name: str, quick: bool) -> None:
    """Print the share of a piece of work in matrix products, outside of operators, and in the longest of them."""
    np, torch = import_module("numpy"), import_module("torch")
    torch.set_num_threads(1)
    work, _ = WORKS[name](quick)
    work()
    matmul = np.matmul

    def recorded(*args: Any, **options: Any) -> object:  # the 2D world multiplies by NumPy
        with torch.profiler.record_function("numpy.matmul"):
            return matmul(*args, **options)

    cpu = [torch.profiler.ProfilerActivity.CPU]
    with mock.patch("numpy.matmul", recorded), torch.profiler.profile(activities=cpu) as found:
        begun = time.perf_counter()
        work()
        wall = (time.perf_counter() - begun) * 1e6
    operators = sorted(found.key_averages(), key=lambda e: -e.self_cpu_time_total)
    inside = sum(e.self_cpu_time_total for e in operators)
    products = sum(e.self_cpu_time_total for e in operators if any(word in e.key for word in ("mm", "conv", "matmul")))
    print(f"\n{name}: {wall / 1e3:.0f} ms, {sum(e.count for e in operators)} calls")
    print(f"  {products / wall:6.1%} matrix products\n  {1 - inside / wall:6.1%} outside of operators")
    for e in operators[:8]:
        print(f"  {e.self_cpu_time_total / wall:6.1%} {e.key}, {e.count} of {e.self_cpu_time_total / e.count:.0f} us")


@contextlib.contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """Check a commit out into a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tree"
        subprocess.run(["git", "worktree", "add", "--quiet", "--detach", path, commit], cwd=ROOT, check=True)
        try:
            yield path
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", path], cwd=ROOT, check=True)


def pairs(name: str, trees: tuple[Path, Path], count: int, quick: bool) -> list[list[list[float]]]:
    """Return seconds and peak memory of both trees, turn by turn; the first turn warms up and is left out."""
    command = [sys.executable, __file__, "--worker", name, *(["--quick"] if quick else [])]
    with contextlib.ExitStack() as stack:
        workers = []
        for tree in trees:
            env = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}
            opened = subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            workers.append(stack.enter_context(opened))

        def turn(worker: subprocess.Popen) -> list[float]:
            worker.stdin.write("\n")
            worker.stdin.flush()
            answer = worker.stdout.readline()
            if not answer:
                raise SystemExit(f"{name}: the worker of {worker.args} stopped; its message is above")
            return json.loads(answer)

        turns = [[turn(worker) for worker in workers] for _ in range(count + 1)]
    return turns[1:]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", nargs="?", help="what to compare with")
    parser.add_argument("--profile", action="store_true", help="where the time goes, without a comparison")
    parser.add_argument("--quick", action="store_true", help="a tenth of the steps of whole trials, five epochs")
    parser.add_argument("--only", default="", help="works whose name holds these words")
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--worker", choices=WORKS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        serve(options.worker, options.quick)
        return
    if options.profile == bool(options.commit):
        parser.error("expected either a commit to compare with, or --profile")
    if options.profile:
        for name in WORKS:
            if options.only in name:
                profile(name, options.quick)
        return
    torch, records = import_module("torch"), module("runs.records")
    print(f"{records.provenance()['processor']}, torch {torch.__version__}, one thread; CPU milliseconds", end="")
    print(f", medians of {options.pairs} pairs\n")
    print(f"{'':58} {options.commit[:9]:>10} {'now':>10} {'ratio':>6} {'quartiles':>12} {'MiB':>6} {'now':>6}")
    with worktree(options.commit) as old:
        for name in WORKS:
            if options.only in name:
                turns = pairs(name, (old, ROOT), options.pairs, options.quick)
                (before, old_peak), (now, peak) = (
                    [statistics.median(turn[side][what] for turn in turns) for what in (0, 1)] for side in (0, 1)
                )
                ratios = [new[0] / was[0] for was, new in turns]
                low, middle, high = statistics.quantiles(ratios, method="inclusive") if len(ratios) > 1 else 3 * ratios
                print(f"{name:58} {1e3 * before:10.3f} {1e3 * now:10.3f} {middle:6.3f}", end="")
                print(f" {low:5.3f}, {high:5.3f} {old_peak:6.0f} {peak:6.0f}", flush=True)


if __name__ == "__main__":
    main()
