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

images, names = (raw := np.load(sys.argv[1]).astype(np.float32)) / raw.max(), sys.argv[2].split(",")
layers = [(nn.Flatten,), (nn.Linear, images[0].size, 100), (nn.ReLU,), (nn.Dropout,), (nn.Linear, 100, len(names))]
learner = DropoutLearner(lambda: nn.Sequential(*(kind(*sizes) for kind, *sizes in layers)))
stored = np.loadtxt(file, int, delimiter=",") if (file := Path("labels.csv")).exists() else np.c_[0:5, [-1] * 5]
pool, labels = pools.Pool(stored[:, 0], np.setdiff1d(np.arange(len(images)), stored[:, 0])), -torch.ones(len(images))
labels = labels.long().scatter(0, *torch.from_numpy(stored).T)  # a class, or -1 where it has not been given
for _ in range(int(sys.argv[3])):
    if (labels[pool.labelled] >= 0).all():
        learner.hold(torch.from_numpy(images), labels, len(names), 0)
        learner.fit(pool.labelled[None])
        loop.acquire(learner, [pool], "bald", 5, draws=20, subset=1_000, generators=[torch.default_generator])
    for point in pool.labelled[labels[pool.labelled] < 0].tolist():
        image.imsave("asked.png", images[point].squeeze(), vmin=0, vmax=1)
        while (answer := input(f"image {point}, see asked.png ({sys.argv[2]}): ")) not in names:
            continue
        labels[point] = names.index(answer)
    np.savetxt(file, torch.stack([pool.labelled, labels[pool.labelled]], 1), "%d", delimiter=",")
