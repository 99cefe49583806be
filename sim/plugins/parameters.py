"""Parameters of a plugin that `mi.traverse` reads and changes, each with its unit and range."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from correlograph.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a plugin.

    Attributes:
        unit: SI unit in words; empty for ratios and counts.
        low, high: the range, both ends included.
        default: None if the scene must define the parameter.
        zero: whether zero, which disables an effect, is legal below `low`.
    """

    name: str
    unit: str
    low: float
    high: float
    default: float | None = None
    zero: bool = False

    def validate(self, plugin: str, value: Any) -> float:
        """Return the value as a float. Raises InputError, in the unit of the parameter, outside its range."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if self.low <= number <= self.high or (self.zero and number == 0.0):
            return number
        unit = f" {self.unit}" if self.unit else ""
        raise InputError(
            f"{plugin}.{self.name}",
            f"{'0, or ' if self.zero else ''}{self.low:g} to {self.high:g}{unit}",
            value,
            f"correct {self.name}",
        )


class Parameters:
    """Values of a plugin's parameters; `mi.traverse` holds the same arrays, so that an update changes both."""

    def __init__(self, plugin: str, known: tuple[Parameter, ...], props: mi.Properties) -> None:
        self._plugin, self._known = plugin, {parameter.name: parameter for parameter in known}
        self._given: dict[str, float] = {}
        for name, parameter in self._known.items():
            if parameter.default is None and name not in props:
                raise InputError(
                    f"{plugin}.{name}", f"a number in {parameter.unit or 'no unit'}", "none", "add it to the scene"
                )
            self._given[name] = parameter.validate(plugin, props.get(name, parameter.default))
        self._shown = {name: mi.Float64(value) for name, value in self._given.items()}

    def refuse_unknown(self, names: Iterable[str], *others: str) -> None:
        """Raise InputError for names of parameters that neither the plugin nor `others` has."""
        known = [*self._known, *others]
        for name in names:
            near = difflib.get_close_matches(name, known, 1)
            remedy = f"did you mean {near[0]}?" if near else "correct its name or remove it"
            raise InputError(self._plugin, f"the parameters {', '.join(known)}", f"unknown parameter {name}", remedy)

    def __getitem__(self, name: str) -> float:
        return self._given[name]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        for name, value in self._shown.items():
            callback.put(name, value, mi.ParamFlags.NonDifferentiable)

    def adopt_changes(self, then: Callable[[], None]) -> None:
        """Adopt the changes of `mi.traverse`; an impossible value is refused and the former one remains."""
        before = dict(self._given)
        try:
            for name, value in self._shown.items():
                self._given[name] = self._known[name].validate(self._plugin, float(value[0]))
            then()
        except InputError:
            self._given = before
            for name, value in before.items():
                self._shown[name][0] = value
            then()
            raise
