"""Parameters of plugins: their table, their ranges, their messages."""

from pathlib import Path

import pytest

pytest.importorskip("mitsuba")

import sim  # noqa: F401
from correlograph.errors import InputError
from sim.plugins.table import PLUGINS, table


def test_documented_parameters_agree_with_the_code():
    assert (Path(__file__).parents[3] / "docs" / "parameters.md").read_text() == table()


@pytest.mark.parametrize(("plugin", "parameter"), [(plugin, known) for plugin, many in PLUGINS.items() for known in many])
def test_ranges_hold_and_messages_speak_their_unit(plugin, parameter):
    assert parameter.validate(plugin, parameter.low) == parameter.low
    assert parameter.validate(plugin, parameter.high) == parameter.high
    for value in (2.0 * parameter.high, float("nan"), "much"):
        unit = parameter.unit.split()[0] if parameter.unit else ""
        with pytest.raises(InputError, match=rf"^{plugin}\.{parameter.name}: expected .*{unit}"):
            parameter.validate(plugin, value)
    if parameter.default is not None:
        assert parameter.validate(plugin, parameter.default) == parameter.default
