"""What the notebook of section 5.3 asks for in one call: the runs of a profile, live runs, and pictures of both."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from tqdm.auto import trange

from dropout_uncertainty.exploration import experiment
from dropout_uncertainty.exploration.experiment import PUBLISHED, Config
from dropout_uncertainty.exploration.report import analysis
from dropout_uncertainty.exploration.report.analysis import BURN_IN, TARGET, Agents, Curves
from dropout_uncertainty.page.plotting import COLOURS, band
from dropout_uncertainty.page.profiles import computed
from dropout_uncertainty.page.tables import Words
from dropout_uncertainty.stats import in_words, smaller_median


def agents(profile: str) -> dict[str, Agents]:
    """Return the agents of each published config, and of ``ours`` together; in ``quick`` short runs, checked."""
    quick = [unit for name in PUBLISHED for unit in experiment.units(f"quick/{name}", range(100, 105))]
    full = [unit for name in PUBLISHED for unit in experiment.units(name, range(10))]
    names = [*PUBLISHED, "ours"]
    with computed(profile, quick, full) as folder:
        if folder is None:
            return {name: analysis.load(name) for name in names}
        found = {name: analysis.load(f"quick/{name}", folder, published=False) for name in names}
    analysis.check_quick(found["as-demo"])
    return found


def target(profile: str) -> float:
    """Return the average reward that crossings count to: that of the text, or a lower one for short runs."""
    return 0.8 if profile == "quick" else TARGET


def advantage(profile: str, **worlds: Agents) -> Words:
    """Return how many times as long ε-greedy takes to the target as Thompson sampling, world by world."""
    found = []
    for world, agents in worlds.items():
        pair = [agents[name] for name in ("thompson", "epsilon-greedy")]
        late = [curves.label for curves in pair if np.isinf(smaller_median(curves.crossings(target(profile))))]
        times = analysis.advantage(agents, "thompson", "epsilon-greedy", target(profile))
        said = f"not known, since fewer than half of the runs of {' and of '.join(late)} arrive"
        found.append(f"in {world.replace('_', ' ')} **{in_words(times, '.1f') if not late else said}**")
    return Words(
        "How many times as long as Thompson sampling ε-greedy takes, from the end of the burn-in to a reward of "
        f"{target(profile):g}: {'; '.join(found)} (95 % intervals). The thesis says 175 / 25 = 7, to a reward of 1. "
        "The ratio needs no unit."
    )


def late(profile: str) -> tuple[int, int]:
    """Return a range of ticks late in the runs of a profile."""
    return (10_000, 15_000) if profile == "quick" else (200_000, 1_000_000)


def original(profile: str) -> Agents | None:
    """Return the curves of the original program; none in ``quick``, whose runs are too short to stand beside them."""
    return None if profile == "quick" else analysis.original()


def groups(profile: str, found: Mapping[str, Agents], *, as_written: bool = False) -> dict[str, Agents]:
    """Return agents by the worlds they were in, with those of the original program, on request also as written."""
    chosen = {"one (as-demo)": "as-demo", "separate (ours)": "ours", "one (as-written)": "as-written"}
    shown = {words: found[name] for words, name in chosen.items()}
    if theirs := original(profile):
        shown["original program"] = theirs
        if as_written:
            shown["original, as written"] = analysis.original("as-written")
    return shown


def learn(name: str, config: Config, seeds: Sequence[int]) -> Curves:
    """Run the one agent of a config before the reader's eyes, and return what it did."""
    run = experiment.start(config, seeds)
    for _ in (bar := trange(run.total, desc=name)):
        bar.set_postfix_str(run.advance())
    (curves,) = analysis.from_arrays(name, config, run.result(), seeds).values()
    return curves


def live_rewards(ax: Axes, live: Mapping[str, Curves], burn_in: int = BURN_IN) -> Axes:
    """Draw the average reward of live runs against ticks; a line marks the end of the burn-in."""
    colours = itertools.cycle(COLOURS[name] for name in ("thompson", "annealed-thompson", "epsilon-greedy", "greedy"))
    for curves in live.values():
        band(ax, curves.ticks, curves.average, colour=next(colours), label=curves.label)
    ax.axvline(burn_in, color="#888888", linewidth=0.8)
    place = (burn_in, ax.get_ylim()[0])
    ax.annotate("end of the burn-in", place, xytext=(4, 4), textcoords="offset points")
    ax.set(xlabel="ticks", ylabel="average reward")
    ax.legend()
    return ax


def values(axes: Sequence[Axes], found: Mapping[str, Float[np.ndarray, "S 5"]]) -> None:
    """Draw the values of the five moves under S weight draws, one panel per agent; above: how often each is best."""
    for ax, (title, q) in zip(axes, found.items(), strict=True):
        jitter = np.random.default_rng(100).uniform(-0.25, 0.25, q.shape)
        ax.plot(np.arange(5) + jitter, q, ".", color=COLOURS["thompson"], alpha=0.15)
        ax.set_xticks(range(5), ("straight", "bit left", "bit right", "hard left", "hard right"))
        ax.set_title(title)
        for action, share in enumerate(np.bincount(q.argmax(-1), minlength=5) / len(q)):
            ax.annotate(f"{share:.0%}", (action, 1), xycoords=("data", "axes fraction"), ha="center", va="top")
    axes[0].set(ylabel="value under one draw")


def exploring(found: Agents, ticks: tuple[int, int]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells: how often agents do not what is best known, and their average reward, over some ticks."""
    cells: list[list[object]] = []
    for curves in found.values():
        share, reward = curves.share("explored", *ticks).mean(), curves.mean(*ticks).mean()
        cells.append([curves.label, f"{100 * share:.1f} %", f"{reward:.3f}"])
    return ["", "moves not the best known", "average reward"], cells
