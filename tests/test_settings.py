"""Settings of every section: equal ones have equal hashes, and what cannot be meant is refused in a sentence."""

from dataclasses import dataclass, field, fields, replace

import numpy as np
import pytest

from dropout_uncertainty.active_learning import experiment as active_learning
from dropout_uncertainty.data_efficiency.deep_pilco import learner as deep_pilco
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.exploration import experiment as exploration
from dropout_uncertainty.exploration.foraging.world import Rules
from dropout_uncertainty.settings import config_dict, config_diff, config_hash, of_type, tidy, widened

CONFIGS = {
    "5.2": active_learning.Config(pool=50, subset=20, random_from=30),
    "5.3": exploration.OURS["epsilon-greedy"],
    "5.3 rules": Rules(),
    "5.4 plant": cartpole.PAPER,
    "5.4 PILCO": pilco.PILCO_PAPER,
    "5.4 Deep PILCO": deep_pilco.OURS,
}


def numbers(config, kind):
    """Return the names of the fields that hold a number of that type."""
    return [field.name for field in fields(config) if type(getattr(config, field.name)) is kind]


@dataclass(frozen=True)
class Settings:
    count: int = 3
    most: int | None = None
    rate: float = 0.5
    shares: tuple[float, ...] = (0.0, 1.0)
    widths: tuple[int, ...] = (4,)
    name: str = "a"
    on: bool = True

    def __post_init__(self):
        tidy(self)


def test_settings_that_are_meant_alike_are_alike():
    plain = Settings(count=3, most=7, rate=1.0, shares=(0.0, 1.0), widths=(4, 5))
    for given in (
        {"rate": 1, "shares": (0, 1)},
        {"rate": np.float32(1.0), "shares": np.array([0.0, 1.0])},
        {"count": np.int8(3), "most": np.uint64(7), "widths": np.array([4, 5]), "on": np.bool_(True)},
        {"shares": [0, 1.0], "widths": [4, np.int32(5)], "name": np.str_("a")},
    ):
        assert config_hash(replace(plain, **given)) == config_hash(plain)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": 2.0}, "count must be a whole number, got 2.0"),
        ({"count": True}, "count must be a whole number, got True"),
        ({"count": "3"}, "count must be a whole number, got '3'"),
        ({"most": 2.5}, "most must be a whole number, got 2.5"),
        ({"rate": float("nan")}, "rate must be a finite number, got nan"),
        ({"rate": float("inf")}, "rate must be a finite number, got inf"),
        ({"rate": None}, "rate must be a finite number, got None"),
        ({"shares": (0.5, "half")}, "shares must be a finite number, got 'half'"),
        ({"widths": (4.5,)}, "widths must be a whole number, got 4.5"),
        ({"widths": 4}, "widths must be a tuple, got 4"),
        ({"name": None}, "name must be of type str, got None"),
        ({"on": 1}, "on must be of type bool, got 1"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(given, message):
    with pytest.raises(ValueError, match=message):
        Settings(**given)


@pytest.mark.parametrize("given", ["paper", None, {"pole_length": 0.6}])
def test_a_config_inside_another_is_no_name(given):
    with pytest.raises(ValueError, match=r"^plant must be of type CartPole, got .*, make one by CartPole\(...\)"):
        of_type(cartpole.CartPole, given, "plant")


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_every_section_is_held_to_it(config):
    for name in numbers(config, float):
        with pytest.raises(ValueError, match=r"must be|number|does nothing here"):
            replace(config, **{name: float("nan")})


@dataclass(frozen=True)
class Inner:
    x: float = 1.0
    late: str | None = field(default=None, metadata={"before": None})


@dataclass(frozen=True)
class Grown:
    rounds: int = 3
    drop: tuple[float, float] = (0.25, 0.5)
    late: int = field(default=7, metadata={"before": 5})
    inner: tuple[Inner, ...] = ()


#: As a record has it that was made before the class grew.
STORED = {"rounds": 3, "drop": [0.25, 0.5]}


def test_a_config_may_grow_without_losing_its_records():
    as_before = Grown(late=5, inner=(Inner(),))
    assert config_dict(as_before) == {"rounds": 3, "drop": [0.25, 0.5], "inner": [{"x": 1.0}]}
    assert config_hash(as_before) == config_hash({**STORED, "inner": [{"x": 1.0}]})
    assert config_hash(Grown()) != config_hash(Grown(late=5))
    assert config_hash(Grown(inner=(Inner(late="a"),))) != config_hash(Grown(inner=(Inner(),)))
    assert config_diff(Grown(late=5), Grown()) == [("late", 5, 7)]
    assert config_diff(STORED | {"inner": []}, Grown()) == [("late", 5, 7)], "a stored config and one of today"
    assert config_diff(STORED | {"inner": []}, Grown(late=5)) == []


@dataclass(frozen=True)
class MoreSettings(Settings):
    more: int = 7


def test_a_wider_config_has_the_values_of_the_other_but_for_what_is_changed():
    config = replace(Settings(), rate=0.25, name="b")
    wider = widened(MoreSettings, config, name="c")
    assert wider == MoreSettings(rate=0.25, name="c", more=7)
    with pytest.raises(TypeError, match="nonsense"):
        widened(MoreSettings, config, nonsense=1)
