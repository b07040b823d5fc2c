"""The README's examples run as they stand when they are pasted one after the other, the two long ones made shorter."""

import contextlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: What makes an example that takes minutes take seconds here: (text in the README, what stands there instead).
SHORTER = [("20_000", "1_000"), ("trials=10", "trials=1, model_steps=2, policy_steps=2, guard=1.0")]


def snippets():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
