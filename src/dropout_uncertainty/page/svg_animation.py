"""Animations for a page: moving shapes with play, step, slider and speed, in plain JavaScript and from no other host.

A frame is a list of shapes, and so is the background that does not move. The first frame is part of the page as a
drawing, so something is to be seen without scripts too; paper has the last one as well. Where a reader has asked for
less motion the animation waits to be started. Draw what should fit both the light and the dark page in
``currentColor``, the colour of the text.
"""

import json
from collections.abc import Sequence
from html import escape

from dropout_uncertainty.page.svg import SHOWN, Number, Shape, Value

__all__ = ["Player"]


class Player:
    """An animation that a notebook and the book show.

    Args:
        frames: for every moment its shapes; shape number k must be of the same kind in all frames and have the same
            attributes. To let one vanish, give it a radius of 0 or ``visibility="hidden"`` (else ``"visible"``).
        size: width and height of the drawing, in the units of the shapes; y points down.
        description: what is to be seen, for those who do not see it.
        labels: one or more lines of text per frame, shown below it.
        background: shapes that do not move.
        rate: frames per second at normal speed.

    Raises:
        ValueError: if there are no frames, if labels are missing, or if frames do not consist of the same shapes.
    """

    def __init__(
        self,
        frames: Sequence[Sequence[Shape]],
        size: tuple[Number, Number],
        description: str,
        labels: Sequence[str],
        *,
        background: Sequence[Shape] = (),
        rate: Number = 15.0,
    ) -> None:
        if not frames:
            raise ValueError("an animation needs at least one frame, got none")
        if len(labels) != len(frames):
            raise ValueError(f"expected one label per frame, got {len(labels)} for {len(frames)} frames")
        kinds = [(shape.tag, shape.attributes.keys()) for shape in frames[0]]
        for number, frame in enumerate(frames):
            if [(shape.tag, shape.attributes.keys()) for shape in frame] != kinds:
                raise ValueError(f"all frames need the same shapes with the same attributes, frame {number} differs")
        self.frames, self.size, self.description = frames, size, description
        self.labels, self.background, self.rate = labels, background, rate

    def changes(self) -> list[dict[int, dict[str, Value]]]:
        """Return for each frame what differs from the one before: new values of attributes, by number of the shape.

        The first entry holds everything, so that one can go back to it.
        """
        listed, before = [], [dict[str, Value]() for _ in self.frames[0]]
        for frame in self.frames:
            now = [dict(shape.attributes) | {"": shape.content} for shape in frame]
            new = [
                {name: value for name, value in values.items() if old.get(name) != value}
                for old, values in zip(before, now, strict=True)
            ]
            listed.append({number: values for number, values in enumerate(new) if values})
            before = now
        return listed

    def _repr_html_(self) -> str:
        data = json.dumps([self.changes(), list(self.labels), self.rate], separators=(",", ":"), ensure_ascii=False)
        width, height = self.size
        return TEMPLATE.format(
            style=STYLE,
            width=width,
            height=height,
            description=escape(self.description),
            background="".join(shape.svg() for shape in self.background),
            first="".join(shape.svg() for shape in self.frames[0]),
            end="".join(shape.svg() for shape in self.frames[-1]),
            last=len(self.frames) - 1,
            label=escape(self.labels[0]),
            end_label=escape(self.labels[-1]),
            script=SCRIPT,
            data=data.replace("</", "<\\/"),  # nothing in the data may end the script
        )


#: Drawn in the colour of the text: book.css takes away the light ground that the theme gives HTML on dark pages.
STYLE = """
.player { margin: 0; max-width: SHOWNpx; }
.player svg { display: block; width: 100%; height: auto; }
.player .controls { display: flex; flex-wrap: wrap; gap: 0.4em; align-items: center; margin-top: 0.4em; }
.player .controls[hidden] { display: none; }
.player .controls > * { font: inherit; }
.player :is(button, select) { padding: 0.15em 0.6em; border: 1px solid; border-radius: 0.25em; background: none;
  color: inherit; }
.player button { min-width: 4.6em; cursor: pointer; }
.player option { color: black; background: white; }
.player input { flex: 1 1 8em; min-width: 6em; }
.player p { margin-top: 0.2em; color: inherit; text-align: left; white-space: pre-line;
  font-variant-numeric: tabular-nums; }
.player .end { display: none; break-inside: avoid; }
@media print { .player .end { display: block; } .player .controls { display: none; } }
""".replace("SHOWN", str(SHOWN))

TEMPLATE = """<figure class="player">
<style>{style}</style>
<svg viewBox="0 0 {width} {height}" role="img" aria-label="{description}">
<g>{background}</g><g class="moving">{first}</g>
</svg>
<div class="controls" hidden="">
<button type="button" class="play">Play</button>
<button type="button" class="back">Back</button>
<button type="button" class="step">Step</button>
<input type="range" min="0" max="{last}" value="0" aria-label="time"/>
<label>speed <select><option value="0.25">¼</option><option value="0.5">½</option>
<option value="1" selected="">1</option><option value="2">2</option><option value="4">4</option></select></label>
</div>
<p class="label">{label}</p>
<div class="end">
<svg viewBox="0 0 {width} {height}" role="img" aria-label="{description} The end.">{background}{end}</svg>
<p>{end_label}</p>
</div>
<script>({script})(document.currentScript.parentElement, ...{data})</script>
</figure>"""

#: Gets the figure, the changes from frame to frame, the labels and the frames per second.
SCRIPT = """(figure, changes, labels, rate) => {
  const find = (selector) => figure.querySelector(selector);
  const shapes = find(".moving").children;
  const [play, back, step, slider, speed] = [".play", ".back", ".step", "input", "select"].map(find);
  const last = changes.length - 1;

  // The attributes of every shape in every frame; shapes that stay as they are share them with the frame before.
  const frames = [];
  changes.reduce((before, change) => {
    const now = before.slice();
    for (const [k, values] of Object.entries(change)) now[k] = { ...now[k], ...values };
    frames.push(now);
    return now;
  }, []);

  let at = 0, shown = [], playing = false, timer;

  function show(frame) {
    at = Math.max(0, Math.min(last, frame));
    frames[at].forEach((values, k) => {
      if (values === shown[k]) return;
      for (const [name, value] of Object.entries(values)) {
        if (name === "") shapes[k].textContent = value;
        else shapes[k].setAttribute(name, value);
      }
    });
    shown = frames[at];
    slider.value = at;
    slider.setAttribute("aria-valuetext", labels[at]);
    find(".label").textContent = labels[at];
  }

  function advance() {
    show(at + 1);
    if (at === last) run(false);
    else timer = setTimeout(advance, 1000 / rate / speed.value);
  }

  function run(on) {
    clearTimeout(timer);
    playing = on;
    play.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (at === last) show(0);
    timer = setTimeout(advance, 1000 / rate / speed.value);
  }

  const stopAt = (frame) => { run(false); show(frame); };
  play.onclick = () => run(!playing);
  back.onclick = () => stopAt(at - 1);
  step.onclick = () => stopAt(at + 1);
  slider.oninput = () => stopAt(Number(slider.value));
  find(".controls").hidden = false;
  show(0);

  // It starts when it comes into view, unless the reader wants less motion or has touched it before.
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  const seen = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    if (at === 0 && !playing) run(true);
  }, { threshold: 0.5 });
  seen.observe(find("svg"));
}"""
