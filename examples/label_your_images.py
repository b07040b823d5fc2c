"""Label your own images: a network with dropout asks for those whose labels would tell it most (BALD).

python examples/label_your_images.py images.npy ant,bee,cow 20   # [N, H, W] or [N, H, W, C], classes, rounds of five
"""

import sys

import numpy as np
import torch
from matplotlib import image
from torch import nn

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import DropoutLearner, loop, pools

images, names = (raw := np.load(sys.argv[1]).astype(np.float32)) / raw.max(), sys.argv[2].split(",")
layers = [(nn.Flatten,), (nn.Linear, images[0].size, 100), (nn.ReLU,), (nn.Dropout,), (nn.Linear, 100, len(names))]
learner = DropoutLearner(lambda: nn.Sequential(*(kind(*sizes) for kind, *sizes in layers)))
pool, labels = pools.Pool([0, 1, 2, 3, 4], range(5, len(images))), torch.zeros(len(images), dtype=torch.long)
for step in range(int(sys.argv[3])):
    for point in pool.labelled[-5:].tolist():
        image.imsave("asked.png", images[point].squeeze(), vmin=0, vmax=1)
        while (answer := input(f"image {point}, see asked.png ({sys.argv[2]}): ")) not in names:
            continue
        labels[point] = names.index(answer)
    np.savetxt("labels.csv", torch.stack([pool.labelled, labels[pool.labelled]], 1), "%d", delimiter=",")
    learner.hold(torch.from_numpy(images), labels, len(names), 0)
    learner.fit(pool.labelled[None])
    generators = [rng.generator(0, "policy", step)]
    loop.acquire(learner, [pool], "bald", 5, draws=20, subset=1_000, generators=generators)
