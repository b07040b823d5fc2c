"""The worlds of the chapter by their names in Gymnasium, which is optional and takes its time to import.

After ``import dropout_uncertainty`` and ``import gymnasium``, in whatever order,
``gymnasium.make("dropout_uncertainty/CartPoleSwingUp-v0")`` finds them.
"""

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

#: Registered names, and where the environments are.
ENVIRONMENTS = {
    "dropout_uncertainty/CartPoleSwingUp-v0": "dropout_uncertainty.data_efficiency.plant.environment:CartPoleSwingUp",
    "dropout_uncertainty/ForagingWorld-v0": "dropout_uncertainty.exploration.foraging.environment:ForagingWorld",
    "dropout_uncertainty/DeepSea-v0": "dropout_uncertainty.exploration.deep_sea.environment:DeepSeaEnv",
}


def announce() -> None:
    """Register the environments now if Gymnasium is imported, otherwise as soon as it is."""
    if sys.modules.get("gymnasium"):
        register()
    else:
        sys.meta_path.insert(0, _Waiting())


def register() -> None:
    """Register the environments with Gymnasium."""
    import gymnasium

    for name, place in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=place)


class _Waiting:
    """Lets the import of Gymnasium end with ``register``; does nothing for any other module.

    A finder by what it does: to inherit from ``importlib.abc`` would take a fifth of the time of the whole import.
    """

    looking = False

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "gymnasium" or self.looking:
            return None
        self.looking = True  # the other finders are asked
        try:
            spec = importlib.util.find_spec(name)
        finally:
            self.looking = False
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                sys.meta_path.remove(self)  # not before: some only ask whether Gymnasium is there
                execute(module)
                register()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
