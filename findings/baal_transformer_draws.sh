#!/usr/bin/env bash
# baal 2.1.0 with PyTorch 2.15.0: whether MC dropout draws anything from a transformer depends on `batch_first`.
#
# Guess: in `MCDropoutModule` every dropout layer is active whenever it predicts, so draws differ for any network that
#   has one.
# Seen: with `batch_first=True`, all draws of a network with a TransformerEncoderLayer are the same and BALD is rounding
#   noise, without a word; with `batch_first=False` they differ. The layer's fast path for inference, taken in
#   evaluation mode without gradients, computes everything in one operation and does not ask its dropout layers, whatever
#   these have been replaced by. Plain PyTorch with `network.eval()` and then `train()` for the dropout layers alone, as
#   MC dropout is often written, does the same; with gradients on, the draws differ again.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile torch==2.15.0 numpy==2.3.5 scipy==1.16.3 \
  scikit-learn==1.7.2 structlog==22.3.0 tqdm==4.67.1 pillow==12.0.0 matplotlib==3.10.7 torchmetrics==1.8.2
python3 -m pip --python "$folder/venv" install --quiet --no-compile --no-deps baal==2.1.0
"$folder/venv/bin/python" -W ignore - 2> /dev/null <<'END'
import torch
from baal.active.heuristics import BALD
from baal.bayesian.dropout import MCDropoutModule
from baal.modelwrapper import ModelWrapper, TrainingArgs
from torch import nn
from torch.utils.data import TensorDataset

torch.manual_seed(0)
points = TensorDataset(torch.randn(8, 5, 16), torch.zeros(8))
layers = {
    "nn.Dropout": nn.Dropout(),
    **{
        f"transformer, batch_first={first}": nn.TransformerEncoderLayer(16, 2, 32, dropout=0.5, batch_first=first)
        for first in (False, True)
    },
}
same = {}
for name, layer in layers.items():
    network = nn.Sequential(layer, nn.Flatten(), nn.Linear(80, 3))
    wrapper = ModelWrapper(MCDropoutModule(network), TrainingArgs(batch_size=8, use_cuda=False))
    draws = wrapper.predict_on_dataset(points, iterations=20)
    same[name] = bool((draws == draws[..., :1]).all())
    print(f"{name}: draws all the same: {same[name]}; largest BALD {BALD().get_uncertainties(draws).max():.1e}")

layer = layers["transformer, batch_first=True"].eval()
for part in layer.modules():
    if isinstance(part, nn.Dropout):
        part.train()
with torch.no_grad():
    without = torch.equal(layer(points.tensors[0]), layer(points.tensors[0]))
with_gradients = torch.equal(layer(points.tensors[0]), layer(points.tensors[0]))
print(f"plain PyTorch: two draws the same without gradients: {without}, with gradients: {with_gradients}")
raise SystemExit(0 if list(same.values()) == [False, False, True] and without and not with_gradients else 1)
END
