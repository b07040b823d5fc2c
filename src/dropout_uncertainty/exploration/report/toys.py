"""The toy of section 5.3: two slot machines, for a reader to try."""

from dropout_uncertainty.exploration.report.analysis import LABELS
from dropout_uncertainty.page.plotting import COLOURS
from dropout_uncertainty.page.sliders import Slider, Toy

__all__ = ["play_machines"]

#: The rules that play, in the order of the script.
RULES = ("thompson", "epsilon-greedy")


def play_machines() -> Toy:
    """Return a figure in which a reader sets how two machines pay and how greedy ε-greedy is."""
    sliders = [
        Slider("first", "first machine pays", 0.4, 0.05, 0.95, 0.05),
        Slider("second", "second machine pays", 0.6, 0.05, 0.95, 0.05),
        Slider("epsilon", "random plays of ε-greedy, ε", 0.1, 0, 1, 0.05),
        Slider("repetitions", "repetitions", 300, 50, 1000, 50),
    ]
    data = [[LABELS[name], COLOURS[name]] for name in RULES]
    lead = "Play yourself: set with which probability each machine pays, and how often ε-greedy plays at random."
    return Toy(lead, "How often two rules play the better of two machines, against the play.", MACHINES, sliders, data)


MACHINES = """
(names) => ({ first, second, epsilon, repetitions }, random) => {
  const plays = 300, pays = [first, second], better = second >= first ? 1 : 0;
  const normal = () => Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());
  const gamma = (shape) => { // Marsaglia and Tsang (2000), for shapes of at least 1
    const d = shape - 1 / 3;
    for (;;) {
      const x = normal(), v = (1 + x / Math.sqrt(9 * d)) ** 3;
      if (v > 0 && Math.log(1 - random()) < x * x / 2 + d * (1 - v + Math.log(v))) return d * v;
    }
  };
  const beta = ({ wins, losses }) => {
    const won = gamma(wins);
    return won / (won + gamma(losses));
  };
  const larger = (machines, value) => (value(machines[1]) > value(machines[0]) ? 1 : 0);
  const rules = [
    (machines) => larger(machines, beta),
    (machines) => (random() < epsilon ? Math.floor(2 * random())
      : larger(machines, ({ wins, losses }) => wins / (wins + losses))),
  ];
  const shares = rules.map((choose) => {
    const share = new Array(plays).fill(0);
    for (let r = 0; r < repetitions; r++) {
      const machines = pays.map(() => ({ wins: 1, losses: 1 })); // Beta(1, 1): anything is possible
      for (let play = 0; play < plays; play++) {
        const chosen = choose(machines);
        machines[chosen][random() < pays[chosen] ? "wins" : "losses"] += 1;
        if (chosen === better) share[play] += 1 / repetitions;
      }
    }
    return share;
  });
  const won = (share) => share.reduce((sum, s) => sum + s * pays[better] + (1 - s) * pays[1 - better], 0);
  const count = Array.from({ length: plays }, (_, play) => play);
  return {
    panels: [{
      x: { low: 0, high: plays, ticks: [0, 100, 200, 300], label: "play" },
      y: { low: 0, high: 1, ticks: [0, 0.25, 0.5, 0.75, 1], label: "share that plays the better machine" },
      paths: shares.map((y, k) => ({ x: count, y, label: names[k][0], stroke: names[k][1], "stroke-width": 2 })),
    }],
    words: "Coins won in 300 plays, on average: "
      + shares.map((share, k) => `${won(share).toFixed(1)} (${names[k][0]})`).join(", ")
      + `; the better machine alone pays ${(plays * pays[better]).toFixed(0)}.`,
  };
}"""
