"""Figures that a page computes anew when a reader moves a slider: plain JavaScript, and nothing from another host.

They stand below a figure of matplotlib that shows the same, so that nothing is missing without scripts, on paper or in
an e-book, where they are not to be seen.
"""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from dropout_uncertainty.page.svg import SHOWN

__all__ = ["FLOATS", "Slider", "Toy", "floats"]

Number = int | float


@dataclass
class Slider:
    """A number that the reader sets: its name in the script, the words beside it, where it starts and its limits.

    A start outside the limits moves them, and one that no step leads to makes the steps finer: a browser would change
    it without a word.
    """

    name: str
    label: str
    start: Number
    low: Number
    high: Number
    step: Number

    def __post_init__(self) -> None:
        self.low, self.high = min(self.low, self.start), max(self.high, self.start)
        steps = (self.start - self.low) / self.step
        if abs(steps - round(steps)) > 1e-6:
            self.step = 10.0 ** int(Decimal(str(self.start)).as_tuple().exponent)


def floats(values: ArrayLike) -> str:
    """Return numbers in single precision as text, row by row, which a script reads with FLOATS."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode()


#: Reads in JavaScript what ``floats`` has written.
FLOATS = "(text) => new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer)"


class Toy:
    """A figure with sliders that a notebook and the book show.

    Args:
        lead: what a reader can do; it is to be seen only where the figure is.
        description: what is to be seen, for those who do not see it.
        script: a JavaScript function of ``data``. It returns a function of the values of the sliders and of a source of
            random numbers from [0, 1), which returns ``{panels, words}``: the pictures, and what they say in numbers.
            A panel has ``x`` and ``y``, each ``{low, high, ticks, label}``, and ``paths``: ``{x, y}``, with ``dots``
            for points, ``label`` for the legend and attributes of SVG.
        sliders: what can be set.
        data: what the script needs to know, as JSON.
        chance: whether there is a button for other random numbers.
    """

    def __init__(
        self,
        lead: str,
        description: str,
        script: str,
        sliders: Sequence[Slider],
        data: object = None,
        *,
        chance: bool = True,
    ) -> None:
        self.lead, self.description, self.script, self.sliders = lead, description, script, sliders
        self.data, self.chance = data, chance

    def _repr_html_(self) -> str:
        return TEMPLATE.format(
            style=STYLE,
            lead=escape(self.lead),
            description=escape(self.description),
            sliders="\n".join(CONTROL.format(**{k: escape(str(v)) for k, v in vars(s).items()}) for s in self.sliders),
            again=AGAIN * self.chance,
            script=SCRIPT,
            compute=self.script.strip(),
            data=json.dumps(self.data, separators=(",", ":")).replace("</", "<\\/"),
        )


#: Drawn in the colour of the text: book.css takes away the light ground that the theme gives HTML on dark pages.
STYLE = """
.toy { margin: 0; max-width: SHOWNpx; }
.toy[hidden] { display: none; }
.toy .panels { display: flex; flex-wrap: wrap; gap: 0.5em 1em; }
.toy svg { flex: 1 1 18em; min-width: 0; height: 250px; font-size: 12px; fill: currentColor; }
.toy svg path { stroke-linejoin: round; }
.toy .legend { display: flex; flex-wrap: wrap; gap: 0 1.2em; }
.toy .legend i { display: inline-block; width: 1.6em; height: 0.3em; margin-right: 0.4em; vertical-align: middle; }
.toy .controls { display: grid; grid-template-columns: repeat(auto-fill, minmax(17em, 1fr)); gap: 0 1.5em; }
.toy label { display: flex; gap: 0.6em; align-items: center; justify-content: end; min-height: 2em; }
.toy label span { flex: 1; }
.toy input { width: 8em; min-height: 1.75em; }
.toy output { width: 2.6em; font-variant-numeric: tabular-nums; }
.toy button { padding: 0.15em 0.6em; border: 1px solid; border-radius: 0.25em; background: none; color: inherit;
  font: inherit; cursor: pointer; }
.toy figcaption { margin-top: 0.3em; color: inherit; text-align: left; font-variant-numeric: tabular-nums; }
@media print { .toy { display: none; } }
""".replace("SHOWN", str(SHOWN))

CONTROL = (
    '<label><span>{label}</span><input type="range" name="{name}" min="{low}" max="{high}" step="{step}" '
    'value="{start}"><output>{start}</output></label>'
)
AGAIN = '<div><button type="button">Draw again</button></div>'

TEMPLATE = """<figure class="toy" hidden="">
<style>{style}</style>
<p>{lead}</p>
<div class="controls">
{sliders}
{again}
</div>
<div class="legend"></div>
<div class="panels" role="img" aria-label="{description}"></div>
<figcaption aria-live="polite"></figcaption>
<script>({script})(document.currentScript.parentElement, {compute}, {data})</script>
</figure>"""

#: Gets the figure, the function of ``Toy`` and its data. ``figure.compute`` is for tests.
SCRIPT = """(figure, prepare, data) => {
  const find = (selector) => figure.querySelector(selector);
  const inputs = [...figure.querySelectorAll("input")];
  const compute = (figure.compute = prepare(data));
  let seed = 0x9e3779b9, due = false;

  // Marsaglia (2003), "Xorshift RNGs"
  function stream(seed) {
    let state = seed;
    return () => {
      state ^= state << 13;
      state ^= state >>> 17;
      state ^= state << 5;
      return (state >>> 0) / 2 ** 32;
    };
  }

  function element(tag, attributes, content = "") {
    const written = Object.entries(attributes).map(([name, value]) => `${name}="${value}"`);
    return `<${tag} ${written.join(" ")}>${content}</${tag}>`;
  }

  function draw(svg, { x, y, paths }) {
    const box = svg.getBoundingClientRect(), left = 34, top = 20;
    if (!box.width) return; // on paper there is no figure
    const width = box.width - left - 12, height = box.height - top - 38;
    const place = ({ low, high }, size) => (value) => +(((value - low) / (high - low)) * size).toFixed(1);
    const across = place(x, width), down = place({ low: y.high, high: y.low }, height);
    const named = ({ ticks }) => ticks.map((tick) => [tick].flat()).map(([at, name]) => [at, name ?? at]);
    const grid = { stroke: "currentColor", "stroke-opacity": 0.2 };
    const words = (at, content, anchor) => element("text", { ...at, "text-anchor": anchor }, content);
    const path = ({ x, y, dots, label, ...style }) => {
      const move = (i) => (dots || i === 0 ? "M" : "L") + `${across(x[i])} ${down(y[i])}` + (dots ? "h0" : "");
      const round = { fill: "none", "stroke-linecap": dots ? "round" : "butt" };
      return element("path", { ...round, ...style, d: Array.from(x, (_, i) => move(i)).join("") });
    };
    svg.setAttribute("viewBox", `0 0 ${box.width} ${box.height}`);
    svg.innerHTML = [
      words({ x: 0, y: 12 }, y.label, "start"),
      words({ x: left + width / 2, y: top + height + 34 }, x.label, "middle"),
      ...named(x).map(([at, name]) => words({ x: left + across(at), y: top + height + 16 }, name, "middle")),
      ...named(y).map(([at, name]) => words({ x: left - 6, y: top + down(at) + 4 }, name, "end")),
      element("svg", { x: left, y: top, width, height },
        y.ticks.map((at) => element("path", { ...grid, d: `M0 ${down(at)}H${width}` })).join("")
        + paths.map(path).join("")),
    ].join("");
  }

  function show() {
    due = false;
    const values = Object.fromEntries(inputs.map((input) => [input.name, Number(input.value)]));
    inputs.forEach((input) => (input.nextElementSibling.value = input.value));
    const { panels, words } = compute(values, stream(seed));
    const drawn = find(".panels");
    panels.slice(drawn.children.length).forEach(() => drawn.insertAdjacentHTML("beforeend", "<svg></svg>"));
    panels.forEach((panel, k) => draw(drawn.children[k], panel));
    const named = panels.flatMap((panel) => panel.paths).filter((path) => path.label);
    find(".legend").innerHTML = named
      .map((path) => `<span><i style="background: ${path.fill ?? path.stroke};`
        + ` opacity: ${path["fill-opacity"] ?? 1}"></i>${path.label}</span>`).join("");
    find("figcaption").textContent = words;
  }

  // once for all that happens between two pictures
  function soon() {
    if (!due) requestAnimationFrame(show);
    due = true;
  }

  figure.hidden = false;
  inputs.forEach((input) => (input.oninput = soon));
  if (find("button")) find("button").onclick = () => { seed = Math.imul(seed, 0x9e3779b9); soon(); };
  show();
  new ResizeObserver(soon).observe(figure);
}"""
