"""Time of a tick of section 5.3 by part, and against the number of replicas that run side by side.

    python benchmarks/exploration.py [--quick] [--config as-demo]

Seconds are CPU seconds of one thread (with a GPU at hand, a second table has seconds of the clock on it). The replay
memories are full and every tick learns, as through most of a run. Arithmetic counts only the matrix products that one
minibatch needs; its share of the machine's rate is that of float32 products of large matrices, measured here too.
"""

import argparse
import functools
import resource
import time

import torch

from dropout_uncertainty.exploration import q_network
from dropout_uncertainty.exploration.deep_sea import experiment as seas
from dropout_uncertainty.exploration.deep_sea.config import EPISODES
from dropout_uncertainty.exploration.experiment import BLOCK, CONFIGS, Foraging, start
from dropout_uncertainty.exploration.foraging import world
from dropout_uncertainty.exploration.foraging.world import CHUNK
from dropout_uncertainty.rng import generator
from dropout_uncertainty.runs.records import provenance

#: Ticks per second of the original with its two agents, on one core under Node 20: as it is, and with the numerical
#: part of its learning step in a compiled kernel. Measured once, on another machine.
ORIGINAL, COMPILED = 100, 2_600


class Stopwatch:
    """Adds up seconds by part, without those of the parts within it."""

    def __init__(self, clock=time.process_time):
        self.clock, self.seconds, self.within = clock, {}, [0.0]

    def watch(self, owner, name, part):
        """Time the method ``name`` of an object or module under ``part``."""
        method = getattr(owner, name)
        self.seconds.setdefault(part, 0.0)

        @functools.wraps(method)
        def timed(*arguments, **named):
            self.within.append(0.0)
            begin = self.clock()
            try:
                return method(*arguments, **named)
            finally:
                took = self.clock() - begin
                self.seconds[part] += took - self.within.pop()
                self.within[-1] += took

        setattr(owner, name, timed)


def process(config, replicas, device="cpu"):
    """Return a process whose memories are full, after one block to warm up."""
    made = start(config, range(100, 100 + replicas), device=device)
    for agent in made.agents:
        numbers = generator(100, "benchmark", device=device)
        agent.memory.memory.uniform_(generator=numbers)
        agent.memory.stored = agent.memory.capacity
    made.advance()
    return made


def seconds(work, clock, repeats):
    """Return the least seconds of a few calls."""
    times = []
    for _ in range(repeats):
        begin = clock()
        work()
        times.append(clock() - begin)
    return min(times)


def clock_of(device):
    """Return CPU time, or the time on the clock once the GPU has finished."""
    if device == "cpu":
        return time.process_time
    return lambda: (torch.cuda.synchronize(), time.perf_counter())[1]


def matrix_rate(device="cpu", size=1024):
    """Return the floating-point operations per second of float32 matrix products."""
    a = torch.ones(size, size, device=device)
    calls = 10 if device == "cpu" else 200

    def work():
        for _ in range(calls):
            torch.mm(a, a)

    work()
    return 2 * size**3 * calls / seconds(work, clock_of(device), 3)


def operations(made: Foraging):
    """Return the floating-point operations in the matrix products of one tick of one replica, all agents."""
    total = 0
    for agent in made.agents:
        weights = [a * b for a, b in zip(agent.network.sizes[:-1], agent.network.sizes[1:], strict=True)]
        forward = 2 * (2 * agent.batch + 2) * sum(weights)
        backward = 2 * agent.batch * (sum(weights) + sum(weights[1:]))
        total += forward + backward
    return total


def by_part(config, replicas, blocks):
    """Print CPU time per tick of every part."""
    made, watch = process(config, replicas), Stopwatch()
    watch.watch(made.world, "sense", "world: eyes")
    watch.watch(made.world, "inputs", "world: eyes")
    watch.watch(made.world, "step", "world: step and reward")
    watch.watch(made.world, "reward", "world: step and reward")
    watch.watch(world, "coming_numbers", "random numbers")
    watch.watch(q_network, "product", "learn: matrix products")
    for agent in made.agents:
        watch.watch(agent, "prepare", "random numbers")
        watch.watch(agent, "act", "act: state, memory, policy")
        watch.watch(agent.memory, "read", "learn: gather the minibatch")
        watch.watch(agent, "_learn", "learn: rest")
        for name, part in (("forward", "forward"), ("backward", "backward"), ("descend", "descent")):
            watch.watch(agent.network, name, f"learn: {part}, but for products")
    watch.watch(made, "advance", "book-keeping")
    masks = q_network.MaskStream.at
    watch.watch(q_network.MaskStream, "at", "learn: masks")
    for _ in range(blocks):
        made.advance()
    q_network.MaskStream.at, q_network.product = masks, q_network.product.__wrapped__
    world.coming_numbers = world.coming_numbers.__wrapped__
    total = sum(watch.seconds.values())
    print(f"\nMicroseconds of a tick by part, {replicas} replicas of {len(made.agents)} agents")
    for part, spent in sorted(watch.seconds.items(), key=lambda item: -item[1]):
        print(f"  {part:32} {1e6 * spent / blocks / BLOCK:7.0f}  {spent / total:4.0%}")
    print(f"  {'together, the stopwatch included':32} {1e6 * total / blocks / BLOCK:7.0f}")


def by_replicas(config, counts, blocks, device="cpu"):
    """Print how fast worlds run and learn, against their number."""
    rate, clock = matrix_rate(device), clock_of(device)
    print(f"\n{provenance(device)['processor']}, float32 matrix products: {rate / 1e9:.0f} GFLOP/s")
    print(f"{'replicas':>8} {'ticks/s':>9} {'x replicas':>11} {'of the rate':>12} {'peak memory':>12}", end="")
    print(f" {'/ original':>11} {'/ compiled':>11}")
    for count in counts:
        made = process(config, count, device)
        took = seconds(made.advance, clock, blocks) / BLOCK
        share = operations(made) * count / took / rate
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        if device != "cpu":
            peak = torch.cuda.max_memory_allocated() / 2**30
        print(f"{count:8d} {1 / took:9.0f} {count / took:11.0f} {share:12.1%} {peak:8.2f} GiB", end="")
        print(f" {count / took / ORIGINAL:11.1f} {count / took / COMPILED:11.1f}")


def deep_sea(blocks, networks=40):
    """Print how many learning steps each kind of agent takes in Deep Sea, all that a move needs included."""
    print(f"\nDeep Sea of 10, {networks} networks: learning steps per second (6,700 with one-hot vectors)")
    for agent in ("epsilon-greedy", "dropout-per-episode", "ensemble-priors"):
        config = seas.CONFIGS[f"deep-sea/{agent}/10"]
        made = seas.start(config, range(100, 100 + networks // config.members))
        for _ in range(2):
            made.advance()
        steps = EPISODES * config.size * networks
        print(f"  {agent:20} {steps / seconds(made.advance, time.process_time, blocks + 2):7.0f}")


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer replicas and repeats")
    parser.add_argument("--config", default="as-demo", choices=CONFIGS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    config, blocks = CONFIGS[options.config], 1 if options.quick else 3
    print(f"config {options.config}, torch {torch.__version__}, one thread; random numbers drawn {CHUNK} ticks ahead")
    counts = (1, 10) if options.quick else (1, 10, 40)
    by_replicas(config, counts[:2], blocks)
    by_part(config, 10, blocks)
    if not options.quick:
        by_replicas(config, counts[2:], blocks)
    deep_sea(blocks)
    if torch.cuda.is_available():
        by_replicas(config, (*counts, 1000), blocks, "cuda")


if __name__ == "__main__":
    main()
