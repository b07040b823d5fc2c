#!/usr/bin/env bash
# PyTorch 2.15.0: the gradient of `clamp` at its limits depends on whether these are numbers or tensors.
#
# Guess: at a limit the gradient of clamp is 1, as it was in 2.13, and the same for limits -5 and 0 given as numbers or
#   as tensors of no dimension, since both are the same function.
# Seen: with numbers it is 0 at both limits, with tensors 0.5; in 2.13.0 it is 1 with either. A logarithm of a standard
#   deviation that starts at its limit, or was set to it, and is pulled inside by the loss, therefore leaves it in 2.13
#   and with tensors, and with numbers stays where it is for ever.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/look.py" <<'END'
import torch

low, high = -5.0, 0.0
ways = {"numbers": (low, high), "tensors": (torch.tensor(low), torch.tensor(high))}
seen = {}
for name, limits in ways.items():
    x = torch.tensor([low, high], requires_grad=True)
    (gradient,) = torch.autograd.grad(x.clamp(*limits).sum(), x)
    start = torch.tensor(low, requires_grad=True)
    descent = torch.optim.SGD([start], lr=0.1)
    for _ in range(100):
        descent.zero_grad()
        (start.clamp(*limits) + 1).square().backward()
        descent.step()
    seen[name] = (gradient.tolist(), round(start.item(), 2))
    print(f"torch {torch.__version__}, {name}: gradient at the limits {gradient.tolist()}, from -5 towards -1: {start:.2f}")
new = {"numbers": ([0.0, 0.0], -5.0), "tensors": ([0.5, 0.5], -1.0)}
old = {name: ([1.0, 1.0], -1.0) for name in ways}
raise SystemExit(0 if seen == (new if torch.__version__.startswith("2.15") else old) else 1)
END
for version in 2.13.0 2.15.0; do
  python3 -m venv --without-pip "$folder/$version"
  python3 -m pip --python "$folder/$version" install --quiet --no-compile "torch==$version" numpy==2.3.5
  "$folder/$version/bin/python" "$folder/look.py"
done
