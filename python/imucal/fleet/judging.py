"""Statistics over the units of a store, as methods of `Fleet`."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.capability import CapabilityResult, capability
from imucal.fleet.statistics.drift import DriftResult, drift
from imucal.fleet.statistics.effect_search import FleetGap, effect_search, searchable
from imucal.fleet.statistics.fitted_effects import Fitted, UnitFiles, fitted_effects
from imucal.fleet.statistics.grr import GrrResult, grr
from imucal.fleet.statistics.outliers import OutlierResult, outliers
from imucal.fleet.statistics.spc import SpcResult, spc
from imucal.fleet.statistics.units_of_fleet import first_of_each_unit

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from imucal.limits.limits import Limits

__all__ = ["MOST_UNITS", "Judging"]

# By default, the recordings of at most this number of units are searched for an effect. The search takes
# about 2 s per unit for all effects of the catalogue.
MOST_UNITS: Final = 50


class Judging(ABC):
    """Statistics over selected units; `selection` takes the arguments by which `Fleet` selects rows."""

    @abstractmethod
    def measurements(self, *, covariances: bool = False, **selection: str | None) -> Measurements:
        """The selected calibrations as arrays."""

    @abstractmethod
    def query(self, sql: str, arguments: Sequence[Any] = ()) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Column names and rows of the result of a read-only SQL statement."""

    def conditions_of(self, serial: str) -> dict[str, str]:
        """Station, operator and batch of the last calibration of a unit, if they are known."""
        _, rows = self.query(
            "SELECT station, operator, batch FROM measurements WHERE serial = ? AND names IS NOT NULL "
            "ORDER BY date, id",
            (serial,),
        )
        last = rows[-1] if rows else (None, None, None)
        named = zip(("station", "operator", "batch"), last, strict=True)
        return {name: str(value) for name, value in named if value}

    def drift(self, serial: str | None = None, **selection: str | None) -> DriftResult:
        """Drift of all units, or of one unit, between calibrations on different dates.

        The false discovery rate is controlled over all units, even if the result is for one unit.

        Raises InputError if no unit has two dates.
        """
        return drift(self.measurements(covariances=True, **selection), serial)

    def spc(self, **selection: str | None) -> SpcResult:
        """Control charts of each station, and shifts that are common to the units of a station."""
        return spc(self.measurements(covariances=False, **selection))

    def capability(self, limits: Limits | None = None, **selection: str | None) -> CapabilityResult:
        """Capability indices for `limits`, spread of the true values of the units, and proposed limits."""
        return capability(self.measurements(covariances=False, **selection), limits)

    def grr(
        self, *, by: str = "operator", limits: Limits | None = None, **selection: str | None
    ) -> GrrResult:
        """Repeatability and reproducibility, from repeated measurements by operators or stations.

        by   "operator" or "station"
        """
        measured = self.measurements(covariances=False, **selection)
        widths: dict[str, Any] = {}
        for limit in () if limits is None else limits.parameters:
            if limit.low is not None and limit.high is not None:
                widths |= {name: limit.high - limit.low for name in measured.names if limit.covers(name)}
        return grr(measured, by=by, tolerances=widths)

    def outliers(self, **selection: str | None) -> OutlierResult:
        """Units that are outliers in the space of all parameters and figures of merit."""
        return outliers(self.measurements(covariances=True, **selection))

    def gap(
        self,
        *,
        effects: Sequence[str] | None = None,
        units: int = MOST_UNITS,
        executor: Executor | None = None,
        step: Callable[[], None] = lambda: None,
        **selection: str | None,
    ) -> FleetGap:
        """Search the recordings of several units for effects that are significant over all units together.

        effects    names of effects of the catalogue; None for all effects
        units      maximum number of units that are searched, evenly spread over the selected units
        executor   executor that computes units in parallel: one of `concurrent.futures`, or
                   `Client.get_executor()` of Dask
        step       callback after each unit

        Raises InputError if there are fewer than five units whose recordings determine any of the effects.
        """
        names = searchable(effects)
        found = self._files(units, selection)

        def fit_all(wanted: Sequence[str], beside: Sequence[str]) -> dict[str, Mapping[str, Fitted]]:
            fit = partial(fitted_effects, effects=tuple(wanted), beside=tuple(beside))
            fits: dict[str, Mapping[str, Fitted]] = {}
            for serial, of_unit, _ in (executor.map if executor is not None else map)(fit, found):
                fits[serial] = of_unit
                step()
            return fits

        return effect_search(fit_all, names)

    def _files(self, units: int, selection: Mapping[str, str | None]) -> list[UnitFiles]:
        """The files of the first usable calibration of each unit, for at most `units` units."""
        if units < 1:
            raise InputError(f"units is {units}: give the number of units to search, such as {MOST_UNITS}")
        first, _ = first_of_each_unit(self.measurements(covariances=False, **selection))
        picked = np.unique(np.linspace(0, len(first) - 1, min(units, len(first))).round().astype(int))
        wanted = set(first.serials[picked].tolist()) if len(first) else set()
        _, rows = self.query(
            "SELECT m.serial, m.files, o.options FROM measurements m JOIN options o ON o.id = m.options "
            "WHERE m.verdict IN ('good', 'incomplete') ORDER BY m.date, m.id"
        )
        found: dict[str, UnitFiles] = {}
        for serial, files, text in rows:
            if serial in wanted and serial not in found:
                options = json.loads(text)
                # The datasheet of the unit (argument `unit`) is not used, because its bias instabilities
                # would be added to the standard deviations of each unit. In a mean over units, errors due to
                # bias instability average out.
                arguments = {k: v for k, v in options["calibrate"].items() if k not in ("unit", "folds")}
                found[serial] = UnitFiles(serial, tuple(json.loads(files)), options["read"], arguments)
        return list(found.values())
