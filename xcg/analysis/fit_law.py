"""Fits of laws of rheology to fields, with standard errors."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.laws import LAWS, Law
from xcg.analysis.shallow import nodes_a_support
from xcg.common import drawing
from xcg.common.checks import floats
from xcg.common.messages import SceneWarning, plain, unknown, warn_user
from xcg.fields.formulas.mean_sums import require_fields
from xcg.scene.facts import with_facts
from xcg.scene.schema import COMPONENTS, units_in
from xcg.steps.labels import call_of, provenance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# rounds of the effective variance: each takes the slope of the law from the fit before
_ROUNDS = 4
_SMOOTH = 200  # points of a curve
_LOGARITHMIC = 10.0  # last over first x, from which a curve is drawn over a logarithm
CURVE = "curve"  # variable of a fit that pictures draw
_FREEDOM = 3  # degrees of freedom below which a warning is given


def fit_law(
    f: xr.Dataset,
    law: str | Callable[..., NDArray] = "mu_of_I",
    *,
    x: str | None = None,
    y: str | None = None,
    constants: Mapping[str, float] | None = None,
    guess: Sequence[float] | None = None,
) -> xr.Dataset:
    """Fit a law to two variables of a result, by least squares (computes).

    All values of `y` over `x` that are finite are fitted together; select steps and nodes first. A
    standard error of `y` or `x`, the variable ``<name>_error``, weights the points: `time_average`
    has them of all fields, and ``coarse_grain(errors=True)`` of some fields of each step.

    Parameters
    ----------
    f : xarray.Dataset
        Fields, or any Dataset that has the two variables, coordinates included.
    law : str or callable
        One of the table below, or a function of the values of `x` and of the parameters,
        ``lambda x, a, b: a * x**b``. Arguments by keyword alone are constants; ``first`` is the
        least `x`.
    x, y : str, optional
        Names of the variables; the table has the defaults. Vectors need a component:
        ``f.sel(component="x")``.
    constants : mapping, optional
        Constants of the law by name, for example ``{"density": 1500.0}``.
    guess : sequence of float, optional
        Start of the search, one number for each parameter. Custom laws start at 1.

    Returns
    -------
    xarray.Dataset
        Each parameter and its standard error by name (``mu_s``, ``mu_s_error``, ...),
        ``covariance`` (parameter, other_parameter), ``chi_squared``, the sum of squared residuals
        over squared errors (NaN without errors), ``degrees_of_freedom``, ``point_count``, and
        ``fitted``, the law at each `x`. ``curve`` (curve_x) is the law at 200 points between the
        ends of `x`, and ``curve_error`` its standard error; ``fit_x``, ``fit_y``, ``fit_x_error``
        and ``fit_y_error`` are the points that were fitted. ``law.cg.plot()`` draws them.
        The attribute ``law`` names the law that was fitted and
        ``formula`` has its formula.

    Raises
    ------
    ValueError
        If the law or a variable is unknown, a variable is a vector, there are not more points than
        parameters, a constant is missing, or the search does not converge.

    Warns
    -----
    SceneWarning
        If ``mu_of_I`` falls back to a line, points without a standard error are left out, standard
        errors are infinite, or fewer than three degrees of freedom are left.

    Notes
    -----
    ======================  =====================================================  ==============
    law                     formula                                                x
    ======================  =====================================================  ==============
    ``mu_of_I``             mu = mu_s + (mu_2 - mu_s) / (1 + I_0 / I)              inertial number
    ``mu_of_I_line``        mu = mu_s + slope I                                    inertial number
    ``phi_of_I``            phi = phi_c - slope I                                  inertial number
    ``fluidity``            g = g_first exp(-(z - first) / length)                 z
    ``bagnold``             V = V_s - (V_s - V_first) ((h - z)/(h - first))^(3/2)  z
    ``haff``                T = T_first / (1 + (t - first) / tau)^2                time
    ``beverloo``            Q = C density sqrt(gravity) (D - k diameter)^exponent  opening
    ======================  =====================================================  ==============

    Sources, in this order: Jop, Forterre & Pouliquen (2006); da Cruz et al. (2005), for both lines;
    Kamrin & Koval (2012), of the decay beside a sheared zone, where ``length`` is their xi;
    Silbert et al. (2001); Haff (1983); Beverloo, Leniger & van de Velde (1961), whose exponent is
    5/2, and 3/2 for a slot (flow rate per length).

    ``mu_of_I`` needs rates at which mu bends. Where ``I_0`` is less than two of its standard errors,
    or there are no more than three points, it is a line, with a warning.

    With errors, weights are ``1 / (s_y^2 + (dy/dx)^2 s_x^2)`` (effective variance), and standard
    errors follow from the errors of the data: ``chi_squared`` far above ``degrees_of_freedom`` means that the law
    does not hold or that they are too small. Without, standard errors follow from the scatter about
    the law. Errors of `x` and `y` count as independent. Nodes closer than the kernel's support share
    grains: the covariance is multiplied by the number of nodes in a support.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> I = np.geomspace(1e-3, 0.5, 20)
    >>> mu = 0.38 + (0.64 - 0.38) / (1 + 0.28 / I)
    >>> f = xr.Dataset({"inertial_number": ("z", I), "friction_coefficient": ("z", mu)})
    >>> fit = fit_law(f, "mu_of_I")
    >>> [round(float(fit[name]), 6) for name in ("mu_s", "mu_2", "I_0")]
    [0.38, 0.64, 0.28]
    """
    call = call_of("fit_law", locals())
    require_fields(f, "fit_law")
    f = with_facts(f)
    row = _law_of(law, x, y)
    table = _table(f, row)
    points = _Points.of(table)
    fit = None
    if law != "mu_of_I" or len(points.x) > 3:
        try:
            fit = points.fit(row, constants or {}, guess)
        except RuntimeError as error:
            if law != "mu_of_I":
                raise ValueError(
                    f"fit_law: the search did not converge ({error}); pass guess= near the "
                    "expected values, or select the range where the law holds"
                ) from None
    if law == "mu_of_I" and (fit is None or not 2 * fit.errors[2] < fit.values[2]):
        warn_user(
            SceneWarning(
                "fit_law: the points hold no more than a line, as I_0 is not above two of its "
                "standard errors; fitted mu = mu_s + slope I. Points at larger I show the bend"
            )
        )
        law = "mu_of_I_line"
        row = _law_of(law, x, y)
        fit = points.fit(row, {}, None)
    assert fit is not None
    if not np.isfinite(fit.covariance).all():
        warn_user(
            SceneWarning(
                "fit_law: standard errors are infinite: the points do not determine all parameters, "
                "or lie on the law without scatter"
            )
        )
    freedom = len(points.x) - len(fit.names)
    if freedom < _FREEDOM:
        warn_user(
            SceneWarning(
                f"fit_law: {len(points.x)} points for {len(fit.names)} parameters leave {freedom} degrees of "
                f"freedom: the fit is hardly tested, and standard errors from its scatter are uncertain by "
                f"{(2 * freedom) ** -0.5:.0%}. Fit {_FREEDOM + len(fit.names)} points or more"
            )
        )
    data = _parameters(fit, row, len(points.x), f.attrs.get("unit_system", "SI"))
    of_x = table["law_x"]
    curve = of_x.copy(data=fit.function(of_x.to_numpy(), *fit.values))
    curve.attrs = {"long_name": f"{row.y} by the law"}
    if "units" in f[row.y].attrs:
        curve.attrs["units"] = f[row.y].attrs["units"]
    data["fitted"] = curve
    data |= _drawn(points, fit, f[row.x], f[row.y])
    of_parameters = ("parameter", "other_parameter")
    result = xr.Dataset(data, {dim: list(fit.names) for dim in of_parameters})
    if not isinstance(law, str):
        law = "custom"
    return result.assign_attrs(provenance(f, call), law=law, formula=row.formula)


def _parameters(fit: _Fit, row: Law, count: int, system: str) -> dict[str, Any]:
    """Return the parameters of a fit of `count` points with their errors, and how well it fits."""
    units = dict(zip(fit.names, row.units, strict=False))  # custom laws have none
    data: dict[str, Any] = {}
    for name, value, deviation in zip(fit.names, fit.values, fit.errors, strict=True):
        about = {}
        if name in units:
            about["units"] = units_in(units[name], system)
        data[name] = ((), value, {"long_name": f"{name} of the law"} | about)
        data[f"{name}_error"] = ((), deviation, {"long_name": f"standard error of {name}"} | about)
    numbers = {
        "chi_squared": (fit.chi_squared, "squared residuals over squared standard errors"),
        "degrees_of_freedom": (count - len(fit.names), "points less parameters"),
        "point_count": (count, "number of points"),
    }
    for name, (number, text) in numbers.items():
        data[name] = ((), number, {"units": "1", "long_name": text})
    # each of its elements has a unit of its own
    about = {"long_name": "covariance"}
    data["covariance"] = (("parameter", "other_parameter"), fit.covariance, about)
    return data


def _drawn(
    points: _Points, fit: _Fit, of_x: xr.DataArray, of_y: xr.DataArray
) -> dict[str, xr.Variable]:
    """Return the points of a fit and its curve with standard errors, for pictures."""
    low, high = float(points.x.min()), float(points.x.max())
    curve_x = np.linspace(low, high, _SMOOTH)
    if low > 0 and high > _LOGARITHMIC * low:
        curve_x = np.geomspace(low, high, _SMOOTH)
    values = fit.values
    curve = fit.function(curve_x, *values)
    # derivatives by each parameter, by central differences
    slopes = np.empty((len(values), len(curve_x)))
    for k, deviation in enumerate(fit.errors):
        change = np.zeros(len(values))
        change[k] = 1e-4 * deviation if 0 < deviation < np.inf else 1e-6 * max(1.0, abs(values[k]))
        above = fit.function(curve_x, *(values + change))
        below = fit.function(curve_x, *(values - change))
        slopes[k] = (above - below) / (2 * change[k])
    error = np.sqrt(np.einsum("kn,kl,ln->n", slopes, fit.covariance, slopes).clip(0))
    columns = {
        "curve_x": ("curve_x", curve_x, of_x),
        "curve": ("curve_x", curve, of_y),
        "curve_error": ("curve_x", error, of_y),
        "fit_x": ("fit_point", points.x, of_x),
        "fit_y": ("fit_point", points.y, of_y),
        "fit_x_error": ("fit_point", points.x_error, of_x),
        "fit_y_error": ("fit_point", points.y_error, of_y),
    }
    data = {}
    for name, (dim, numbers, source) in columns.items():
        text = drawing.long_name_of(source, str(source.name))
        if name.endswith("_error"):
            text = f"standard error of {text}"
        about = {"long_name": text}
        if "units" in source.attrs:
            about["units"] = source.attrs["units"]
        data[name] = xr.Variable(dim, numbers, about)
    return data


def draw_fit(fit: xr.Dataset, ax: Axes, **options: Any) -> Axes:
    """Draw the points of a fit, the law, and its band of one standard error.

    Parameters
    ----------
    fit : xarray.Dataset
        What `fit_law` returned.
    ax : matplotlib.axes.Axes
        Where to draw.
    **options
        For the line of matplotlib.

    Returns
    -------
    matplotlib.axes.Axes
    """
    x, y = fit["fit_x"].to_numpy(), fit["fit_y"].to_numpy()
    x_error = fit["fit_x_error"].to_numpy()
    y_error = fit["fit_y_error"].to_numpy()
    errors: dict[str, Any] = {}
    if np.isfinite(y_error).all():
        errors["yerr"] = y_error
    if x_error.any():
        errors["xerr"] = x_error
    ax.errorbar(x, y, **errors, fmt="o", color="C0", label="points")
    numbers = []
    for name in map(str, fit["parameter"].to_numpy()):
        value = float(fit[name])
        spread = float(fit[f"{name}_error"])
        digits = 3
        if 0 < spread < abs(value):  # to the last digit of the error
            digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(spread))
        numbers.append(f"{name} = {value:.{digits}g} ± {spread:.2g}")
    label = "\n".join([fit.attrs["law"], *numbers])
    curve_x, curve = fit["curve_x"].to_numpy(), fit["curve"].to_numpy()
    (line,) = ax.plot(curve_x, curve, **{"color": "black", "label": label, **options})
    around = fit["curve_error"].to_numpy()
    ax.fill_between(
        curve_x, curve - around, curve + around, color=line.get_color(), alpha=0.2, lw=0
    )
    if curve_x[0] > 0 and curve_x[-1] > _LOGARITHMIC * curve_x[0]:
        ax.set_xscale("log")
    drawing.set_label(ax.xaxis, drawing.label_of(fit["fit_x"], "fit_x"))
    drawing.set_label(ax.yaxis, drawing.label_of(fit["fit_y"], "fit_y"))
    ax.legend()
    return ax


def _law_of(law: str | Callable[..., NDArray], x: str | None, y: str | None) -> Law:
    """Return a law with the names of its variables."""
    if isinstance(law, str) and law in LAWS:
        row = LAWS[law]
    elif callable(law):
        row = Law(law)
    else:
        raise ValueError(unknown("law", law, LAWS))
    row = replace(row, x=x or row.x, y=y or row.y)
    if row.x is None or row.y is None:
        raise ValueError("fit_law: a custom law needs x= and y=, names of variables of the Dataset")
    return row


def _table(f: xr.Dataset, row: Law) -> xr.Dataset:
    """Return x, y and their standard errors (NaN if they are unknown) on the same nodes.

    They are called ``law_x`` and ``law_y``, as axes are called x and y.
    """
    columns = {}
    for name, of in (("law_x", row.x), ("law_y", row.y)):
        if of not in f.variables:
            raise ValueError(unknown("variable", of, f.variables))
        if f[of].dtype.kind not in "fiub":
            raise ValueError(
                f"fit_law: expected numbers, and {of!r} holds {f[of].dtype}; "
                f"f.assign_coords({of}=...) gives others, such as seconds"
            )
        columns[name] = f[of].astype(float)
        columns[f"{name}_error"] = f.get(f"{of}_error", xr.DataArray(np.nan))
    if vectors := {"component", "direction"} & {*columns["law_x"].dims, *columns["law_y"].dims}:
        raise ValueError(
            f"fit_law fits {row.y!r} over {row.x!r}, and one has {sorted(vectors)}: select a "
            "component first, f.sel(component='x')"
        )
    arrays = xr.broadcast(*(column.drop_vars(list(column.coords)) for column in columns.values()))
    table = xr.Dataset(dict(zip(columns, arrays, strict=True))).compute()
    table = table.assign_coords({d: f[d] for d in table.dims if d in f.coords})
    along = [a for a in (*COMPONENTS, "r") if a in table.dims and a in f.coords]
    support = 2 * float(np.max(f.attrs.get("cutoff", 0.0)))
    return table.assign_attrs(shared=nodes_a_support(table, along, support))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters of a law, their covariance, and the law with its constants."""

    function: Callable[..., NDArray]
    names: tuple[str, ...]
    values: NDArray
    covariance: NDArray
    chi_squared: float

    @property
    def errors(self) -> NDArray:
        """Standard errors of the parameters."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Points:
    """Points (n,) of a fit, their standard errors, and how many nodes share their grains."""

    x: NDArray
    y: NDArray
    x_error: NDArray
    y_error: NDArray
    shared: float

    @classmethod
    def of(cls, table: xr.Dataset) -> _Points:
        """Select the points that are finite, and that have an error where others have."""
        columns = ("law_x", "law_y", "law_x_error", "law_y_error")
        x, y, x_error, y_error = (table[name].to_numpy().ravel() for name in columns)
        is_used = np.isfinite(x) & np.isfinite(y)
        has_error = is_used & (y_error > 0) & np.isfinite(y_error)
        if has_error.any():
            if without := int((is_used & ~has_error).sum()):
                warn_user(
                    SceneWarning(
                        f"fit_law: {without} of {is_used.sum()} points have no standard error "
                        "above zero and are left out"
                    )
                )
            is_used = has_error
        x_error = np.nan_to_num(x_error[is_used])
        return cls(x[is_used], y[is_used], x_error, y_error[is_used], table.attrs["shared"])

    @property
    def are_weighted(self) -> bool:
        """Return whether the points have standard errors."""
        return bool(len(self.y)) and bool(np.isfinite(self.y_error).all())

    def fit(self, row: Law, constants: Mapping[str, float], guess: Sequence[float] | None) -> _Fit:
        """Fit a law by least squares."""
        from scipy.optimize import OptimizeWarning, curve_fit

        names, function = self._with_constants(row, constants)
        if len(self.x) <= len(names):
            raise ValueError(
                f"fit_law: {len(self.x)} points with finite {row.x!r} and {row.y!r}, expected more "
                f"than the {len(names)} parameters {', '.join(names)}"
            )
        if guess is None and row.guess is not None:
            with np.errstate(all="ignore"):
                guess = row.guess(self.x, self.y)
        values = np.ones(len(names))
        if guess is not None:
            values = floats(guess)
        if values.shape != (len(names),) or not np.isfinite(values).all():
            raise ValueError(
                f"guess={plain(guess)}: expected a finite number for each of {', '.join(names)}"
            )
        sigma = None
        if self.are_weighted:
            sigma = self.y_error
        rounds = 1
        if self.x_error.any():
            rounds = _ROUNDS
        for _ in range(rounds):
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore", OptimizeWarning)
                values, covariance = curve_fit(
                    function,
                    self.x,
                    self.y,
                    values,
                    sigma,
                    absolute_sigma=self.are_weighted,
                    maxfev=10_000,
                )
            if sigma is not None:
                sigma = np.hypot(self.y_error, _slope(function, self.x, values) * self.x_error)
        residual = self.y - function(self.x, *values)
        chi_squared = np.nan
        if sigma is not None:
            chi_squared = float(((residual / sigma) ** 2).sum())
        return _Fit(function, names, values, self.shared * covariance, chi_squared)

    def _with_constants(
        self, row: Law, constants: Mapping[str, float]
    ) -> tuple[tuple[str, ...], Callable[..., NDArray]]:
        """Return the names of the parameters of a law, and the law with its constants."""
        arguments = inspect.signature(row.function).parameters.values()
        fixed = {a.name: a.default for a in arguments if a.kind is inspect.Parameter.KEYWORD_ONLY}
        names = tuple(a.name for a in arguments if a.name not in fixed)[1:]
        values = dict(fixed)
        if "first" in fixed:
            values["first"] = self.x.min(initial=np.inf)
        if not names:
            raise ValueError(
                "fit_law: the law has no parameters; expected a function of x and the parameters, "
                "such as lambda x, a, b: a + b * x"
            )
        if not isinstance(constants, Mapping):
            raise ValueError(
                f"constants={plain(constants)}: expected numbers by name, such as "
                f"{dict.fromkeys(fixed or ['density'], 1.0)}"
            )
        if strange := [name for name in constants if name not in fixed]:
            raise ValueError(unknown("constant", strange[0], fixed))
        values |= constants
        if missing := [n for n, value in values.items() if value is inspect.Parameter.empty]:
            raise ValueError(
                f"fit_law: the law needs the constants {', '.join(missing)}, for example "
                f"constants={dict.fromkeys(missing, 1.0)}"
            )
        return names, partial(row.function, **values)


def _slope(function: Callable[..., NDArray], x: NDArray, values: NDArray) -> NDArray:
    """Return dy/dx of a law at x (n,), by central differences."""
    dx = 1e-6 * np.maximum(np.abs(x), 1e-3 * np.ptp(x))
    return (function(x + dx, *values) - function(x - dx, *values)) / (2 * dx)
