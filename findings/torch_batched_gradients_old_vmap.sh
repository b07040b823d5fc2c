#!/usr/bin/env bash
# PyTorch 2.15.0: `torch.autograd.grad(..., is_grads_batched=True)` does not run on the vmap of `torch.func`.
#
# Guess: a backward pass of one's own that `torch.func.vmap` takes is taken by `is_grads_batched=True` too, which is said
#   to be a vmap over the gradients.
# Seen: in 2.13.0 and 2.15.0 it is an older vmap with rules of its own. A backward pass with `Tensor.unflatten` raises
#   RuntimeError ("Batching rule not implemented for aten::unflatten.int") where `torch.func.vmap` takes the same backward
#   pass; with `reshape` in the place of `unflatten` both take it and agree.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/look.py" <<'END'
import torch

ways = {
    "unflatten": lambda g: g.unflatten(-1, (2, 3)).sum(-1).repeat_interleave(3, -1),
    "reshape": lambda g: g.reshape(2, 3).sum(-1).repeat_interleave(3, -1),
}


def batched(back):
    class Twice(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            return 2 * x

        @staticmethod
        def backward(ctx, g):
            return back(g)

    x = torch.zeros(6, requires_grad=True)
    return torch.autograd.grad(Twice.apply(x), x, torch.eye(6), is_grads_batched=True)[0]


seen, func = {}, {name: torch.func.vmap(back)(torch.eye(6)) for name, back in ways.items()}
for name, back in ways.items():
    try:
        seen[name] = "agrees" if torch.equal(batched(back), func[name]) else "differs"
    except RuntimeError as error:
        seen[name] = str(error).split(".")[0]
print(f"torch {torch.__version__}: {seen}")
expected = {"unflatten": "Batching rule not implemented for aten::unflatten", "reshape": "agrees"}
raise SystemExit(0 if seen == expected and torch.equal(*func.values()) else 1)
END
for version in 2.13.0 2.15.0; do
  python3 -m venv --without-pip "$folder/$version"
  python3 -m pip --python "$folder/$version" install --quiet --no-compile "torch==$version" numpy==2.3.5
  "$folder/$version/bin/python" "$folder/look.py"
done
