"""From the text to ours: every choice once in either direction, and nothing else."""

import pytest

from dropout_uncertainty.data_efficiency import configs
from dropout_uncertainty.data_efficiency.ablations import literal
from dropout_uncertainty.data_efficiency.deep_pilco.learner import AS_TEXT, OURS
from dropout_uncertainty.errors import UserError
from dropout_uncertainty.settings import config_diff, config_hash


@pytest.mark.parametrize("name", literal.CONFIGS)
def test_one_choice_changes(name):
    _, direction, change = name.split("/")
    base, other = (AS_TEXT, OURS) if direction == "add" else (OURS, AS_TEXT)
    field = literal.CHANGES[change]
    differing = {f: new for f, old, new in config_diff(base, literal.CONFIGS[name]) if f != "trials"}
    assert differing == {field: getattr(other, field)}
    assert literal.CONFIGS[name].trials == 25


def test_all_choices_together_lead_from_the_text_to_ours():
    assert len(literal.CHANGES) == 13
    assert len({config_hash(config) for config in literal.CONFIGS.values()}) == 26


def test_units_leave_small_records_and_bad_names_are_named():
    (unit,) = configs.units("literal/add/clip", range(100, 110))
    assert unit.label == "data_efficiency/literal/add/clip/100-109"
    assert unit.start(unit.config, (100,)).kept == ("costs", "predicted_cost", "model_loss")
    with pytest.raises(UserError, match="unknown config 'literal/add/nothing'"):
        configs.units("literal/add/nothing")
