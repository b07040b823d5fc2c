"""Time of one acquisition round of section 5.2 by part, and of scoring beside baal and batchbald_redux.

``python benchmarks/active_learning.py [--precision bfloat16] [--points 2000]``. The peers (extra ``bench``) are timed
if they work; a line says why one does not. They need a torchvision built for the same torch: the one of PyPI belongs to
the torch of PyPI and fails beside a CPU build. CPU seconds of one thread; memory is the peak of the process.
"""

import argparse
import importlib.metadata
import resource
import time
import warnings

import torch
from torch import nn

from dropout_uncertainty.active_learning.experiment import CONFIGS, CNNLearner
from dropout_uncertainty.active_learning.network import BayesianCNN
from dropout_uncertainty.runs.records import provenance

DRAWS = 100


def seconds(work, repeats=3):
    """Return the least CPU seconds of a few calls, after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def torch_network(consistent=nn.Dropout):
    """Return the network of section 5.2 as plain layers, for the peers."""
    return nn.Sequential(
        nn.Conv2d(1, 32, 4), nn.ReLU(), nn.Conv2d(32, 32, 4), nn.ReLU(), nn.MaxPool2d(2), nn.Flatten(),
        consistent(0.25), nn.Linear(3872, 128), nn.ReLU(), consistent(0.5), nn.Linear(128, 10),
    )  # fmt: skip


def with_baal(images):
    from baal.bayesian.dropout import patch_module
    from baal.modelwrapper import ModelWrapper, TrainingArgs

    data = torch.utils.data.TensorDataset(images[:, None], torch.zeros(len(images)))
    # No worker processes, whose CPU time would not be counted.
    wrapper = ModelWrapper(patch_module(torch_network()), TrainingArgs(batch_size=128, use_cuda=False, workers=0))
    return lambda: wrapper.predict_on_dataset(data, iterations=DRAWS, verbose=False)


def with_batchbald(images):
    from batchbald_redux.consistent_mc_dropout import BayesianModule, ConsistentMCDropout

    class Network(BayesianModule):
        def __init__(self):
            super().__init__()
            self.net = torch_network(ConsistentMCDropout)

        def mc_forward_impl(self, x):
            return self.net(x).log_softmax(-1)

    network = Network().eval()

    def score():
        with torch.no_grad():
            return [network(part[:, None], DRAWS) for part in images.split(20)]

    return score


def advice(reason):
    """Return what to do about the failure of a peer."""
    if "torchvision::" in reason:
        vision = importlib.metadata.version("torchvision")
        return f"torchvision {vision} is not built for torch {torch.__version__}: install both from one place"
    return "pip install -e '.[bench]' installs a set that works"


def beside(name, make, images, ours):
    """Return a line on the time of a peer, or on why there is none."""
    try:
        peer = seconds(make(images), 1)
    except Exception as error:  # whatever it is, the others are still to be timed
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no message"
        return f"{name}: {type(error).__name__}: {reason}; {advice(reason)}"
    return f"{name} {importlib.metadata.version(name)}, float32: {peer:.1f} s, {peer / ours:.0f} times ours"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--precision", default="bfloat16")
    parser.add_argument("--points", type=int, default=2_000)
    precision, points = (options := parser.parse_args()).precision, options.points
    torch.set_num_threads(1)
    learner = CNNLearner(CONFIGS["ours/dropout/bald"], [100], precision=precision)
    print(f"{provenance()['processor']}, one thread, {precision}")
    cost = {}
    for labels in (100, 200, 400):
        cost[labels] = seconds(lambda n=labels: learner.fit(torch.arange(n)[None]), 1)
        each = 1e3 * cost[labels] / labels / 50
        print(f"training on {labels} labels, 50 epochs: {cost[labels]:.2f} s, {each:.3f} ms an image")
    test = seconds(learner.test_error)
    candidates = torch.arange(10_000, 10_000 + points)[None]
    ours = seconds(lambda: learner.log_probs(candidates, DRAWS))
    print(f"test error on 10,000 images: {test:.2f} s")
    print(f"scoring {points} points x {DRAWS} draws: {ours:.2f} s")
    run = sum(cost[400] / 400 * labels for labels in range(20, 1001, 10)) + 99 * test + 98 * ours * 2_000 / points
    print(f"a run of 98 rounds, from these: {run / 60:.1f} min")
    images = learner.images[0][candidates[0]]
    for name, make in (("baal", with_baal), ("batchbald_redux", with_batchbald)):
        print(beside(name, make, images, ours))
    print(f"parameters: {sum(p.numel() for p in BayesianCNN([100]).parameters()):,}")
    print(f"peak resident memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
