"""The list of named numbers."""

import pytest

from benchmarks.constants import constants, main


def test_a_constant_is_listed_with_value_and_meaning(capsys):
    main(["invert/assess"])
    (row,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("| FALSE_ALARMS |"))
    assert "`0.01`" in row
    assert "Probability that a capture without fault" in row
    assert "`invert/assess/doubts.py`" in row


@pytest.mark.parametrize("package", ["invert/assess", "invert/field", "invert/likelihood"])
def test_numbers_that_judge_have_a_meaning(package):
    found = list(constants(package))
    assert found
    assert [one.names for one in found if not one.meaning] == []
