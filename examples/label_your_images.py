"""Label your own images: a network with dropout asks for those whose labels would tell it most (BALD).

python examples/label_your_images.py images.npy ant,bee,cow 20   # [N, H, W] or [N, H, W, C], classes, rounds of five
"""

import sys
from pathlib import Path

import numpy as np
import torch
from matplotlib import image
from torch import nn

from dropout_uncertainty.active_learning import DropoutLearner, loop, pools

images, names = (raw := np.load(sys.argv[1]).astype(np.float32)) / (raw.max() or 1), sys.argv[2].split(",")
layers = [(nn.Flatten,), (nn.Linear, images[0].size, 100), (nn.ReLU,), (nn.Dropout,), (nn.Linear, 100, len(names))]
learner = DropoutLearner(lambda: nn.Sequential(*(kind(*sizes) for kind, *sizes in layers)))
lines = file.read_text().splitlines() if (file := Path("labels.csv")).exists() else []  # of an earlier run
given = {int(point): name for point, name in (line.split(",", 1) for line in lines)}
if wrong := {point: name for point, name in given.items() if point >= len(images) or name not in names}:
    sys.exit(f"labels.csv has {wrong}: expected points below {len(images)} and the classes {sys.argv[2]}")
asked = list(given) or list(range(min(5, len(images))))
pool = pools.Pool(asked, np.setdiff1d(np.arange(len(images)), asked))
for _ in range(int(sys.argv[3])):
    if given.keys() >= set(pool.labelled.tolist()) and pool.available.any():
        learner.hold(images, [names.index(given[i]) if i in given else -1 for i in range(len(images))], len(names), 0)
        learner.fit(pool.labelled[None])
        loop.acquire(learner, [pool], "bald", 5, draws=20, subset=1_000, generators=[torch.default_generator])
    for point in (point for point in pool.labelled.tolist() if point not in given):
        image.imsave("asked.png", images[point].squeeze(), vmin=0, vmax=1)
        while (answer := input(f"image {point}, see asked.png ({sys.argv[2]}): ")) not in names:
            continue
        given[point] = answer
        with file.open("a") as out:  # each answer at once, so that none is lost
            out.write(f"{point},{answer}\n")
