"""The toy of section 5.2: three ways to be unsure of an image, for a reader to try."""

from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.sliders import Slider, Toy

__all__ = ["play_unsure"]


def play_unsure() -> Toy:
    """Return a figure in which a reader says what each weight draw thinks of an image, and sees its scores."""
    sliders = [
        Slider("draws", "number of draws", 3, 1, 20, 1),
        Slider("other", "draws for the second class", 1, 0, 20, 1),
        Slider("sure", "how sure each draw is", 0.99, 0.5, 0.99, 0.01),
    ]
    data = [COLOURS[name] for name in ("deep-pilco", "bald")]
    description = "What each weight draw says of an image, and the three scores that follow from it."
    lead = (
        "Make an image clear, ambiguous or unknown yourself: set how many weight draws there are, how many of them are "
        "for the second class, and how sure each of them is."
    )
    return Toy(lead, description, UNSURE, sliders, data, chance=False)


UNSURE = """
([first, second]) => ({ draws, other: wanted, sure }) => {
  const other = Math.min(wanted, draws);
  const p = Array.from({ length: draws }, (_, s) => (s < draws - other ? sure : 1 - sure));
  const mean = p.reduce((sum, value) => sum + value, 0) / draws;
  const entropy = (q) => -[q, 1 - q].reduce((sum, value) => sum + (value > 0 ? value * Math.log(value) : 0), 0);
  const votes = p.filter((value) => value >= 1 - value).length;
  const scores = [
    entropy(mean),
    Math.max(0, entropy(mean) - p.reduce((sum, value) => sum + entropy(value), 0) / draws),
    1 - Math.max(votes, draws - votes) / draws,
  ];
  const [h, bald, ratio] = scores.map((score) => score.toFixed(3));
  const bar = (at, low, high, style) => ({ x: [at, at], y: [low, high], ...style });
  const wide = Math.min(60, 220 / draws), label = (text, s) => (s === 0 ? { label: text } : {});
  return {
    panels: [{
      x: { low: 0.5, high: draws + 0.5, ticks: [1, draws].slice(0, draws), label: "weight draw" },
      y: { low: 0, high: 1, ticks: [0, 0.5, 1], label: "probability of the two classes" },
      paths: p.flatMap((value, s) => [
        bar(s + 1, 0, value, { stroke: first, "stroke-width": wide, ...label("first class", s) }),
        bar(s + 1, value, 1, { stroke: second, "stroke-width": wide, ...label("second class", s) }),
      ]),
    }, {
      x: { low: 0.5, high: 3.5, ticks: [[1, "entropy"], [2, "BALD"], [3, "var. ratios"]], label: "score" },
      y: { low: 0, high: 0.7, ticks: [0, 0.2, 0.4, 0.6], label: "nats; variation ratios: a share" },
      paths: scores.map((score, k) => bar(k + 1, 0, score, { stroke: "currentColor", "stroke-width": 40 })),
    }],
    words: `Predictive entropy ${h} nats, mutual information (BALD) ${bald} nats, variation ratios ${ratio}.`
      + (draws === 1 ? " One draw cannot disagree with itself." : "")
      + (other < wanted ? ` No more than ${draws} of ${draws} draws can be for the second class, not ${wanted}.` : ""),
  };
}"""
