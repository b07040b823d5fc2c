"""Figures 5.5-5.8 and the pictures of section 5.4: numbers in, axes out."""

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import patches
from matplotlib.axes import Axes

from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, CartPole
from dropout_uncertainty.data_efficiency.plant.drawing import CART, DARK, cart_pole, goal
from dropout_uncertainty.data_efficiency.report import analysis
from dropout_uncertainty.data_efficiency.report.analysis import Learning
from dropout_uncertainty.judging.results import thesis_value
from dropout_uncertainty.page.plotting import COLOURS, SMALL, legend_above

__all__ = [
    "angles", "colour_of", "cost_curves", "figure_5_5", "figure_5_6", "figure_5_7", "figure_5_8", "gradient_shares",
    "log_trials", "matched_output", "median_costs", "predicted_and_realised", "predicted_trial", "solved_over_trials",
]  # fmt: skip

#: Size of the symbols in a sketch [points]: that of the formulas in the text.
SYMBOL = 12
STATE, FORCE = "#DCE9F5", "#FBE6C8"
#: Vertical lines of Figure 5.7: id of the printed number, what it is, and the colour it has in the thesis.
PRINTED = (
    ("figure-5.7/pilco/caption", "PILCO", COLOURS["pilco"]),
    ("figure-5.7/deep-pilco/caption", "Deep PILCO", COLOURS["deep-pilco"]),
    ("literature/gu-2016/trials", "Gu et al.", COLOURS["naf"]),
    ("literature/lillicrap-2015/trials", "Lillicrap et al.", COLOURS["ddpg"]),
)


def figure_5_5(ax: Axes) -> Axes:
    """Draw Figure 5.5: which variable of a predicted trial depends on which."""
    names = (r"$X_{t-1}$", r"$X_t$", r"$X_{t+1}$")
    spots = [(2.4 * i, 0.0) for i in range(3)]
    actions = [(2.4 * i + 0.9, -1.25) for i in range(3)]
    ax.plot([-1.3, -0.45], [0, 0], ":", color=DARK)
    for i, (spot, action) in enumerate(zip(spots, actions, strict=True)):
        _node(ax, spot, names[i], STATE)
        _node(ax, action, names[i].replace("X", "U"), FORCE)
        _arrow(ax, spot, action)
        ax.text(spot[0] + 0.22, -0.78, r"$\pi$", ha="right", va="center", fontsize=SYMBOL)
        following = spots[i + 1] if i < 2 else (2.4 * 3, 0.0)
        if i < 2:
            _arrow(ax, spot, following)
            _arrow(ax, action, following)
            ax.text(spot[0] + 1.2, 0.12, r"$f$", ha="center", va="bottom", fontsize=SYMBOL)
        else:
            ax.plot([spot[0] + 0.45, spot[0] + 1.3], [0, 0], ":", color=DARK)
    ax.set(xlim=(-1.4, 6.2), ylim=(-1.75, 0.6), aspect="equal")
    ax.axis("off")
    return ax


def _node(ax: Axes, spot: tuple[float, float], name: str, colour: str) -> None:
    ax.add_patch(patches.Circle(spot, 0.38, facecolor=colour, edgecolor=DARK, linewidth=1.2, zorder=2))
    ax.text(*spot, name, ha="center", va="center", fontsize=SYMBOL, zorder=3)


def _arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    shape = {"arrowstyle": "-|>", "color": DARK, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 14, "linewidth": 1.2}
    direction = np.subtract(end, start) / np.hypot(*np.subtract(end, start))
    ax.annotate("", end - 0.4 * direction, start + 0.39 * direction, arrowprops=shape)


def figure_5_6(ax: Axes, plant: CartPole = PAPER, angle: float = 0.75, position: float = 0.5) -> Axes:
    """Draw Figure 5.6: the cart-pole to scale, with position, angle, length, force and goal."""
    goal(ax, plant)
    cart_pole(ax, plant, np.array([0.0, 0, 0, np.pi]), alpha=0.18)
    cart_pole(ax, plant, np.array([position, 0, 0, angle]))
    length = plant.pole_length
    up, sideways = length * np.cos(angle), -length * np.sin(angle)
    ax.plot([position, position], [0, 0.65 * length], "--", color=DARK, linewidth=1)
    # counter-clockwise from upright, as the angle is counted
    ends = {"theta1": 90, "theta2": 90 + np.degrees(angle)}
    ax.add_patch(patches.Arc((position, 0), 0.9 * length, 0.9 * length, color=DARK, **ends))
    middle = position - 0.53 * length * np.sin(angle / 2), 0.53 * length * np.cos(angle / 2)
    ax.text(*middle, r"$\theta$", fontsize=SYMBOL, ha="center", va="center")
    ax.text(position + sideways / 2 - 0.05, up / 2 - 0.05, r"$l$", fontsize=SYMBOL, ha="center")
    side = position + CART[0] / 2
    shape = {"arrowstyle": "-|>", "color": COLOURS["bald"], "linewidth": 2.5, "mutation_scale": 18}
    ax.annotate("", (side + 0.3, 0), (side, 0), arrowprops=shape)
    ax.text(side + 0.34, 0, r"$u_t$", fontsize=SYMBOL, va="center", color=COLOURS["bald"])
    below = -length - 0.08
    ax.plot([0, 0], [below, -CART[1] / 2], ":", color=DARK, linewidth=1)
    ax.plot([position, position], [below, -CART[1] / 2], ":", color=DARK, linewidth=1)
    ax.annotate("", (position, below), (0, below), arrowprops={"arrowstyle": "<->", "color": DARK, "shrinkA": 0})
    ax.text(position / 2, below - 0.02, r"$x_c$", fontsize=SYMBOL, ha="center", va="top")
    ax.set(xlim=(-0.75, 1.15), ylim=(below - 0.14, length + 0.12), xlabel="metres", ylabel="metres", aspect="equal")
    ax.grid(visible=False)
    return ax


def matched_output(
    axes: Sequence[Axes],
    inputs: Float[np.ndarray, " S"],
    outputs: Float[np.ndarray, " S"],
    curve: tuple[np.ndarray, np.ndarray, np.ndarray],
    matched: tuple[float, float],
) -> None:
    """Draw a Gaussian input sent through a Gaussian process, on two axes side by side that share the output.

    Args:
        axes: for the function and for the distribution of its output.
        inputs: draws of the input.
        outputs: what a draw of the function makes of each.
        curve: x, mean and standard deviation of the function.
        matched: mean and standard deviation of the matched Gaussian.
    """
    function, output = axes
    x, mean, std = curve
    function.fill_between(x, mean - 2 * std, mean + 2 * std, color=COLOURS["pilco"], alpha=0.25, linewidth=0)
    function.plot(x, mean, color=COLOURS["pilco"], label="function: mean and two std")
    shown = slice(0, 300)
    function.plot(inputs[shown], outputs[shown], ".", color=DARK, markersize=3, alpha=0.5, label="particles")
    low, high = function.get_ylim()
    density, edges = np.histogram(inputs, 60, density=True)
    height = 0.22 * (high - low) * density / density.max()
    bottom = low - 0.02 * (high - low)
    function.fill_between(edges[:-1], bottom, bottom + height, step="post", color="#AAAAAA", label="input")
    function.set(xlabel="input", ylabel="output")
    function.legend(loc="upper left")
    output.hist(outputs, 80, density=True, orientation="horizontal", color="#AAAAAA", label="true density")
    y = np.linspace(*function.get_ylim(), 300)
    normal = np.exp(-((y - matched[0]) ** 2) / (2 * matched[1] ** 2)) / (matched[1] * np.sqrt(2 * np.pi))
    output.plot(normal, y, color=COLOURS["bald"], label="matched Gaussian")
    output.set(xlabel="density")
    output.legend(loc="upper right")


def angles(ax: Axes, learning: Learning, trial: int, replica: int = 0) -> Axes:
    """Draw the angle that one repetition predicted for a trial, with two standard deviations, and what happened."""
    t = learning.plant.dt * np.arange(learning.plant.steps + 1)
    mean = learning.arrays["predicted_mean"][replica, trial, :, 3]
    std, colour = learning.predicted_std[replica, trial, :, 3], colour_of(learning)
    ax.fill_between(t, mean - 2 * std, mean + 2 * std, color=colour, alpha=0.25, linewidth=0, label="predicted")
    ax.plot(t, mean, color=colour)
    ax.plot(t, learning.arrays["states"][replica, trial, :, 3], color="black", linewidth=1.3, label="happened")
    ax.set(xlabel="time [s]", ylabel=r"angle $\theta$ [rad]", title=f"trial {trial}")
    return ax


def predicted_trial(axes: Sequence[Axes], learning: Learning, trials: Sequence[int], replica: int = 0) -> None:
    """Draw the predicted and the true angle of several trials side by side; 0 is upright, and so is every full turn."""
    for ax, trial in zip(axes, trials, strict=True):
        angles(ax, learning, trial, replica)
        _turns(ax, learning.arrays["states"][replica, trial, :, 3], margin=0.5 * np.pi)
    for ax in axes[1:]:
        ax.set_ylabel("")
    axes[0].legend()


def predicted_and_realised(axes: Iterable[Axes], learning: Learning, trials: Sequence[int]) -> None:
    """Draw the cost that a trial had against the one predicted for it, one panel a trial, one point per repetition."""
    both = [learning.predicted_costs, learning.trial_costs]
    low = 0.9 * min(costs[:, list(trials)].min() for costs in both)
    for ax, trial in itertools.zip_longest(axes, trials):
        if trial is None:  # a short run has fewer trials than there are panels
            ax.axis("off")
            continue
        ax.plot([0, 1], [0, 1], color=DARK, linewidth=0.8)
        x, y = (costs[:, trial] for costs in both)
        ax.scatter(x, y, s=22, color=COLOURS["pilco"], alpha=0.6, edgecolors="none")
        ax.set(xlim=(low, 1.02), ylim=(low, 1.02), aspect="equal", title=f"trial {trial}")
        ax.set(xlabel="predicted cost per step", ylabel="realised cost per step")
        ax.label_outer()


def cost_curves(ax: Axes, learnings: Sequence[Learning]) -> Axes:
    """Draw mean cost per step against trial on a log axis, with one and two standard errors as two shades."""
    for learning in learnings:
        curves = learning.counted(learning.trial_costs)
        mean = curves.mean(0)
        trial = _cost_curve(ax, learning, mean, f"{learning.label} ({len(curves)})")
        if len(curves) > 1:
            error = curves.std(0, ddof=1) / np.sqrt(len(curves))
            for times in (1, 2):
                _shade(ax, learning, trial, mean - times * error, mean + times * error)
    ax.legend(loc="lower left")
    return log_trials(ax, "mean cost per step")


def median_costs(ax: Axes, learnings: Sequence[Learning]) -> Axes:
    """Draw the median cost per step over the repetitions that are solved in some trial, with quartiles as a shade."""
    for learning in learnings:
        curves = learning.counted(learning.trial_costs)[np.isfinite(learning.first_solved)]
        if len(curves) > 1:
            low, middle, high = np.quantile(curves, (0.25, 0.5, 0.75), axis=0)
            trial = _cost_curve(ax, learning, middle, f"{learning.label} ({len(curves)})")
            _shade(ax, learning, trial, low, high)
    if not ax.get_legend_handles_labels()[0]:
        ax.text(0.5, 0.5, "fewer than two repetitions are solved", ha="center", transform=ax.transAxes)
    return log_trials(ax, "median cost per step")


def _cost_curve(ax: Axes, learning: Learning, costs: np.ndarray, label: str) -> np.ndarray:
    trial = learning.tested
    line = {"pilco-matlab": "--", "original": ":"}.get(learning.config, "-")
    width = 0.8 if learning.config == "pilco-paper-40" else 1.8  # a single repetition behind the others
    ax.plot(trial, costs, line, color=colour_of(learning), linewidth=width, label=label)
    return trial


def _shade(ax: Axes, learning: Learning, trial: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    ax.fill_between(trial, low, high, color=colour_of(learning), alpha=0.2, linewidth=0)


def log_trials(ax: Axes, ylabel: str) -> Axes:
    """Give an axis of trials a logarithmic scale with round numbers, and shares or costs the other."""
    ax.set(xscale="log", ylim=(0, 1.02), xlabel="trial", ylabel=ylabel)
    ticks = [t for t in (1, 2, 5, 10, 20, 50, 100, 400, 1000, 2500) if t <= ax.get_xlim()[1]]
    ax.set_xticks(ticks, [str(t) for t in ticks])
    ax.set_xticks([], minor=True)
    return ax


def figure_5_7(axes: Sequence[Axes], learnings: Sequence[Learning]) -> None:
    """Draw Figure 5.7 on two axes: above the mean over all repetitions, below the median over those that are solved.

    Dashed vertical lines stand where the thesis prints a number of trials, solid ones where half of these repetitions
    are solved. A second axis counts seconds on this plant.
    """
    for ax in axes:
        for learning in (x for x in learnings if len(x.seeds) > 1 and math.isfinite(x.trials_to_solve.value)):
            ax.axvline(learning.trials_to_solve.value, color=colour_of(learning), linewidth=1.1)
        for identifier, _, colour in PRINTED:
            ax.axvline(thesis_value(identifier) or math.nan, color=colour, linestyle="--", linewidth=1.1)
    for identifier, name, colour in PRINTED:
        trials = thesis_value(identifier) or math.nan
        place: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": SMALL, "color": colour}
        axes[0].text(trials, 1.02, f"{name}\n{trials:g}", transform=axes[0].get_xaxis_transform(), **place)
    cost_curves(axes[0], learnings)
    median_costs(axes[1], learnings)
    for ax, title in zip(axes, ("repetitions in brackets", "those solved in brackets"), strict=True):
        if ax.get_legend_handles_labels()[0]:  # beside the curves, of which it would hide some
            ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title=title, handlelength=1)
    axes[0].set_xlabel("")
    _seconds(axes[1], learnings[0].plant)


def _seconds(ax: Axes, plant: CartPole) -> None:
    """Add an axis below that counts the seconds of as many trials."""
    trial = plant.steps * plant.dt

    def seconds(trials: np.ndarray) -> np.ndarray:
        return trial * trials

    def trials(seconds: np.ndarray) -> np.ndarray:
        return seconds / trial

    axis = ax.secondary_xaxis(-0.32, functions=(seconds, trials))  # type: ignore[arg-type]
    axis.set_xscale("log")
    shown = [t for t in (5, 20, 50, 100, 200, 1000, 5000) if t <= trial * ax.get_xlim()[1]]
    axis.set_xticks(shown, [f"{t:,}" for t in shown])
    axis.set_xticks([], minor=True)
    axis.set_xlabel(f"seconds of experience, {trial:g} s a trial")


def colour_of(learning: Learning) -> str:
    """Return the colour of a learner in all figures."""
    name = analysis.NAMES.get(learning.config, "pilco").replace("/", "-")
    return COLOURS.get(name, COLOURS["pilco"])


def solved_over_trials(ax: Axes, learnings: Sequence[Learning], *, ever: bool) -> Axes:
    """Draw the share of repetitions solved by each trial (``ever``), or of those whose trial itself is solved."""
    for learning in learnings:
        trial, solved = learning.tested, learning.counted(learning.solved)
        share = (np.logical_or.accumulate(solved, 1) if ever else solved).mean(0)
        ax.step(trial, share, where="mid", color=colour_of(learning), label=learning.label)
    title = "solved so far" if ever else "this trial is solved"
    ax.set(xlabel="trial", ylim=(-0.02, 1.02), title=title)
    if ever:
        ax.set_ylabel("share of repetitions")
        legend_above(ax)
    return ax


def figure_5_8(axes: Sequence[Axes], learning: Learning, trials: Sequence[int], replicas: Sequence[int]) -> None:
    """Draw Figure 5.8, one panel per trial: the predicted angle in blue, true trials of the policy in green.

    Prediction of each of the repetitions ``replicas``: mean and two standard deviations, by the model that has seen as
    many trials as the title says. Dotted lines are upright: 0 and every full turn. The title also counts steps, means
    over all repetitions.
    """
    t = np.arange(learning.plant.steps + 1)
    angles = np.stack([analysis.repeats(learning, trial)[list(replicas), :, :, 3] for trial in trials])
    for letter, ax, trial, true in zip("abcdefgh", axes, trials, angles, strict=False):
        for replica, ends in zip(replicas, true, strict=True):
            mean = learning.arrays["predicted_mean"][replica, trial, :, 3].astype(float)
            std = learning.predicted_std[replica, trial, :, 3]
            ax.fill_between(t, mean - 2 * std, mean + 2 * std, color=COLOURS["deep-pilco"], alpha=0.2, linewidth=0)
            ax.plot(t, mean, color=COLOURS["deep-pilco"], linewidth=1.2)
            ax.plot(t, ends.T, color="#117733", linewidth=0.7, alpha=0.8)
        _turns(ax, angles, margin=0.5 * np.pi)
        predicted, held, _ = (interval.value for *_, interval in analysis.fitting(learning, trial))
        words = f"({letter}) after trial {trial}\npredicted: {predicted:.0f} steps\nstands: {held:.0f} steps"
        ax.set(xlabel="time step", title=words)
        ax.label_outer()
    for line, words in zip(axes[0].lines, ("predicted, two std", "true trials"), strict=False):
        line.set_label(words)
    axes[0].set_ylabel(f"{learning.label}\nangle $\\theta$ [rad]")
    legend_above(axes[0])


def _turns(ax: Axes, true: np.ndarray, margin: float) -> None:
    """Limit the angles to those that occur, with a margin, and mark every upright one."""
    low, high = true.min() - margin, true.max() + margin
    middle, half = (low + high) / 2, max((high - low) / 2, 1.3 * np.pi)
    ax.set_ylim(middle - half, middle + half)
    for turn in range(-12, 13):
        if abs(2 * np.pi * turn - middle) < half:
            ax.axhline(2 * np.pi * turn, color="#888888", linewidth=0.8, linestyle=":")


def gradient_shares(axes: Sequence[Axes], learning: Learning, trial: int) -> None:
    """Draw, for the beginning of a trial's search, predicted doubt and what each step adds to the gradient.

    Above the standard deviation of the angle, below the share of the gradient with and without doubt; medians over
    repetitions with quartiles.
    """
    doubt, with_doubt, sure = analysis.doubt_and_gradient(learning, trial)
    t = learning.plant.dt * np.arange(1, learning.plant.steps + 1)
    rows = (
        (axes[0], doubt, COLOURS["bald"], "predicted doubt about the angle"),
        (axes[1], with_doubt, COLOURS["pilco"], "model with doubt"),
        (axes[1], sure, COLOURS["random"], "its mean taken for the truth"),
    )
    for ax, values, colour, label in rows:
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75), axis=0)
        ax.plot(t, middle, color=colour, label=label)
        ax.fill_between(t, low, high, color=colour, alpha=0.2, linewidth=0)
    axes[0].axhline(learning.plant.cost_width / learning.plant.pole_length, color=DARK, linewidth=0.8, linestyle=":")
    axes[0].set(yscale="log", title=f"trial {trial}")
    axes[1].set(xlabel="time [s]")
    axes[1].set_ylim(bottom=0)
    place = axes[0].get_subplotspec()
    if place and place.is_first_col():
        axes[0].set_ylabel("std of the angle [rad]")
        axes[1].set_ylabel("share of the gradient")
        legend_above(*axes)
