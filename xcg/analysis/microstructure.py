"""Microstructure of a packing: one number, tensor or distribution for each time and group of particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.analysis.packing import Measure
from xcg.analysis.quantities import QUANTITIES
from xcg.analysis.regions import Bounds
from xcg.common.checks import FINITE, check, check_choice, floats, is_positive, whole
from xcg.common.messages import unknown
from xcg.scene.conform import takes_scene
from xcg.scene.scene import Scene
from xcg.scene.schema import units_in
from xcg.scene.times import require_times, times_are_known
from xcg.steps.analysis import run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of, labelled

FORCE_BINS = np.logspace(-4, 2, 61)
RattlerRule: TypeAlias = Literal["count", "iterative"]
RateSource: TypeAlias = Literal["box", "velocity"]
MixingWeight: TypeAlias = Literal["number", "volume"]


# quantities of the whole series: strains, and the size that each inertial number takes
STRAIN = {
    "volumetric_strain": "volumetric strain of the box, compression positive",
    "axial_strain": "axial strain of the box, compression positive",
}
INERTIAL = {
    "inertial_number_dmax": "d_max",
    "inertial_number_d50": "d50",
    "inertial_number_dbar": "d_bar",
}
NAMES = (*QUANTITIES, *STRAIN, *INERTIAL)
# quantities by the symbols and words that others use for them
_OTHER_NAMES = {
    "z": "coordination_number",
    "phi": "volume_fraction",
    "nu": "volume_fraction",
    "porosity": "volume_fraction",
    "void_fraction": "volume_fraction",
    "packing_fraction": "volume_fraction",
    "solid_fraction": "volume_fraction",
    "p": "mean_stress",
    "pressure": "mean_stress",
    "q": "deviator_stress",
    "eta": "stress_ratio",
    "rattlers": "rattler_count",
    "mixing": "lacey_index",
    "mixing_index": "lacey_index",
    "segregation": "segregation_index",
    "inertial_number": "inertial_number_d50",
    "gsd": "d50",
}


@takes_scene
def microstructure(
    scene: Scene,
    quantities: str | Sequence[str] | None = None,
    *,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    bounds: Bounds | Mapping[str, Bounds] | None = None,
    min_contacts: int = 2,
    rattlers: RattlerRule = "count",
    max_connectivity: int = 63,
    force_bins: ArrayLike | None = None,
    strain_rate: RateSource | float | xr.DataArray | None = None,
    axis: str | None = None,
    cell: float | Mapping[str, float] | None = None,
    mixing_weight: MixingWeight = "number",
    on_error: OnError = "raise",
) -> xr.Dataset:
    r"""Measure the microstructure of a packing, for each time, and for each region or phase.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene. Frozen grains act as walls.
    quantities : str or list of str, optional
        Names below; by default all that the scene's variables allow.
    by : str, optional
        An integer variable of the particles: adds the dimension ``phase``, with "bulk" first.
    groups : list of int, optional
        All values of `by`, where they are not known without reading.
    bounds : mapping, optional
        Bounds of the region that particles' centres lie in (m), ``{"z": (0.0, 0.1)}``; the box
        along other axes. Along a periodic axis they may reach across an edge of the box, and are no
        wider than it. Or such bounds by name, ``{"low": {"z": (0, 1)}, "high": {"z": (1, 2)}}``,
        which adds the dimension ``region``.
    min_contacts : int
        Partners from which a particle counts as load-bearing, in Z_mech and d_bar.
    rattlers : str
        "count": particles with fewer than 4 partners (3 in a one-layer scene) are rattlers.
        "iterative": they are taken out, with their contacts, until every particle left has that
        many.
    max_connectivity : int
        Last bin of ``connectivity``, which takes in all particles with more partners.
    force_bins : array, optional
        Edges of the bins of f / <f>; by default ten a decade from 1e-4 to 100.
    strain_rate : str, float or DataArray, optional
        Deviatoric strain rate (s-1): a number, one a time, "box" (the rate at which the lattice of a
        sheared box changes, else from the strain of the box by finite differences in time), or
        "velocity" (from the affine flow that fits the velocities of each group best). By default
        "box" where the box shears, or is not tilted and has several steps, else "velocity".
    axis : str, optional
        Axis of the axial strain, and of heights in ``segregation_index``; by default the last of the
        scene.
    cell : float or mapping, optional
        Edge of the cells in which the concentration of phases is sampled (m), rounded so that cells
        fill the region; by default 3 d43 of the region's grains. By axis, other axes are not
        divided: ``{"z": 0.01}`` samples layers, for an index of segregation over height. If no cell
        holds two grains, one holds all, or all grains are of one phase, or a random mixture varies as
        much as separate phases (by volume, where few large grains hold most of it), ``lacey_index``
        is NaN, with a warning; another warns where it scatters by more than 0.1 at random (``lacey_noise``).
    mixing_weight : {"number", "volume"}
        What grains count by in concentrations and their variances.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        out (NaN, or padding), warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        Dimensions (time, region, phase), as they apply, and each quantity's own. Lazy over time
        where the scene is. NaN where there is nothing to measure, and where the volume of the
        region is not known.

    Raises
    ------
    SceneError
        If the scene lacks what a quantity needs, times do not rise where a rate is taken from the
        box, or a region is wider than the period of a step.
    ValueError
        If an argument is wrong.

    Notes
    -----
    Sums run over the N particles i whose centre is in the group, of volume V_i, mass m_i, diameter
    d_i and z_i contact partners (walls included, several contacts with one partner counted once),
    and over contacts c with normal n (from j to i: given, else along r_i - r_j, else, at a wall,
    along r_i - c), each weighing w_c: half for each of its particles in the group, whole at a wall.
    D is the dimension of the scene, V the volume of the region.

    =================================  ===================================================================  =========
    quantity                           formula                                                              source
    =================================  ===================================================================  =========
    particle_count, contact_count      :math:`N`, :math:`N_c = \sum w_c`
    volume_fraction                    :math:`\phi = \sum V_i / V`
    coordination_number                :math:`Z = \sum z_i / N` (:math:`2 N_c / N` in the bulk)             [1]_
    mechanical_coordination_number     :math:`Z_{mech} = \sum_{z_i \ge m} z_i / N_{z \ge m}`; for m = 2     [1]_
                                       :math:`(2 N_c - N_1) / (N - N_0 - N_1)`
    rattler_count                      particles of :math:`z_i < D + 1`                                     [2]_
    non_rattler_fraction               :math:`f_{NR}`, 1 - rattlers / N                                     [2]_
    connectivity                       :math:`N_{z_i = z} / N`, the distribution of degrees
    mean_normal_force                  :math:`\langle f_n \rangle`, f_n = f_c . n_c where it is positive
    mean_tangential_force              :math:`\langle f_t \rangle`, f_t = \|f_c - f_n n_c\| there
    normal_force_pdf, _count           :math:`p(f_n / \langle f_n \rangle)`, and number of contacts a bin   [3]_
    tangential_force_pdf, _count       :math:`p(f_t / \langle f_t \rangle)`, the same                       [3]_
    cluster_count                      number of clusters, single grains included
    largest_cluster, _fraction         :math:`s_{max}`, :math:`s_{max} / N`
    percolation                        1 along axes on which a cluster reaches through the box, else 0      [8]_
    fabric                             :math:`F = \sum w_c n n / N_c`                                       [4]_
    fabric_anisotropy                  :math:`\sqrt{3/2\, a:a}`, :math:`a = 15/2\, dev F`; 2D:              [5]_
                                       :math:`\sqrt{a:a / 2}`, :math:`a = 4\, dev F`
    stress                             :math:`\sigma = \sum_i \sum_c f_{ic} (r_i - c) / V`, contacts only   [6]_
    mean_stress                        :math:`p' = tr \sigma / D`
    deviator_stress                    :math:`q = \sqrt{3/2\, s:s}`, s = dev sym :math:`\sigma`; 2D:
                                       :math:`\sqrt{2 s:s}`. Both are :math:`\sigma_1 - \sigma_3` in
                                       axisymmetric states
    stress_ratio                       :math:`\eta = q / p'`
    d_max, d50, d_bar                  largest; half of the volume is smaller;                              [2]_
                                       :math:`\sum V_i d_i / \sum V_i` over :math:`z_i \ge m`
    centre_of_mass                     :math:`\sum m_i r_i / \sum m_i`, NaN along periodic axes
    particle_density                   :math:`\rho = \sum m_i / \sum V_i`
    strain_rate                        :math:`\dot\epsilon_q = \sqrt{2/3\, e:e}`, e the deviatoric rate;
                                       2D: :math:`\sqrt{2 e:e}`
    volumetric_strain, axial_strain    :math:`-\ln(V / V_0)`, :math:`-\ln(L / L_0)` of the box,
                                       relative to the first step of `ds`
    lacey_index                        :math:`(S_0^2 - S^2) / (S_0^2 - S_r^2)`, with `by`                   [7]_
    lacey_noise                        its standard deviation in a random mixture, about                    [9]_
                                       :math:`\sqrt{2 / K} / (n - 1)` for K cells of n grains
    grains_per_cell                    :math:`N / K`, over the K cells that are not empty
    segregation_index                  :math:`(z_a - z_{rest}) / (z_{top} - z_{bottom})`, from centres:     [10]_
                                       1 on top, -1 at the bottom, 0 mixed;
                                       :math:`2 (z_a - z_{rest}) / H` in a uniform bed
    concentration_variance             :math:`S^2 = \sum W_k (c_k - p)^2 / W` over cells
    random_concentration_variance      :math:`S_r^2 = \frac{K - 1}{N - 1} N \sum w_i^2 (a_i - p)^2 / W^2`
    segregated_concentration_variance  :math:`S_0^2 = p (1 - p)`
    inertial_number_{dmax,d50,dbar}    :math:`I = \dot\epsilon_q d \sqrt{\rho / p'}`, NaN if p' <= 0        [2]_
    =================================  ===================================================================  =========

    A cluster is all grains of the group that a path of contacts between them connects. Along a
    periodic axis it reaches through the box where such a path leads to another image of the grain
    that it begins at, along others where the cluster touches walls on both sides, contacts whose
    normal has its largest component along the axis.

    In isochoric triaxial shear :math:`\dot\epsilon_q` is the axial rate; in simple shear it is the
    shear rate over :math:`\sqrt 3` (in a plane: the shear rate).

    Stresses here are contact stresses, with the norms of soil mechanics, as in [2]_. Fields of
    `coarse_grain` have other norms. Where no stress is kinetic, the contact stress is symmetric and
    grains are alike, quantities are these factors times the field:

    ===================  =======================  ====================  ====================
    quantity             field of `coarse_grain`  3D                    2D
    ===================  =======================  ====================  ====================
    mean_stress          pressure                 1                     1
    deviator_stress      shear_stress             :math:`\sqrt 3`       2
    stress_ratio         friction_coefficient     :math:`\sqrt 3`       2
    strain_rate          shear_rate               :math:`1 / \sqrt 3`   1
    inertial_number_d50  inertial_number          :math:`1 / \sqrt 3`   1
    fabric               contact_fabric           1                     1
    fabric               fabric                   :math:`1 / (\phi Z)`  :math:`1 / (\phi Z)`
    fabric_anisotropy    contact_anisotropy       1                     1
    ===================  =======================  ====================  ====================

    References
    ----------
    .. [1] Thornton, C. (2000). Numerical simulations of deviatoric shear deformation of granular media.
       Géotechnique 50.
    .. [2] Shire, T., Hanley, K. J., Stratford, K. (2020). DEM simulations of polydisperse media: efficient contact
       detection applied to investigate the quasi-static limit. Comput. Part. Mech.
    .. [3] Radjai, F., Jean, M., Moreau, J.-J., Roux, S. (1996). Force distributions in dense two-dimensional granular
       systems. Phys. Rev. Lett. 77.
    .. [4] Satake, M. (1982). Fabric tensor in granular materials. IUTAM conference, Delft.
    .. [5] Guo, N., Zhao, J. (2013). The signature of shear-induced anisotropy in granular media. Comput. Geotech. 47.
    .. [6] Love-Weber: Bagi, K. (1996). Stress and strain in granular assemblies. Mech. Mater. 22.
    .. [7] Lacey, P. M. C. (1954). Developments in the theory of particle mixing. J. Appl. Chem. 4.
    .. [8] Newman, M. E. J., Ziff, R. M. (2001). Fast Monte Carlo algorithm for site or bond percolation. Phys. Rev. E
       64.
    .. [9] From the variance of binomial numbers in the cells, see `xcg.analysis.mixing`.
    .. [10] Staron, L., Phillips, J. C. (2014). Segregation time-scale in bi-disperse granular flows. Phys. Fluids 26.

    Examples
    --------
    >>> import xcg
    >>> m = xcg.datasets.face_centred_cubic(3).cg.microstructure(["coordination_number", "stress_ratio"])
    >>> m.coordination_number.item()
    12.0
    """
    call = call_of("microstructure", locals())
    ds = scene.ds
    scene.require((), "microstructure")
    check_choice("rattlers", rattlers, RattlerRule)
    check_choice("mixing_weight", mixing_weight, MixingWeight)
    setup = scene.setup
    regions = _regions(bounds, scene.setup.plane)
    check("min_contacts", min_contacts, whole(1))
    check("max_connectivity", max_connectivity, whole(1))
    if cell is not None:
        _check_cell(cell, setup.plane)
    rate = _rate_source(ds, strain_rate)
    names = _choose(scene, quantities, rate, by)
    up = axis or setup.plane[-1]
    setup.check_axis(up)
    if (
        "segregation_index" in names
        and up in setup.periodic
        and not all(up in r for r in regions.values())
    ):
        raise ValueError(
            f"segregation_index: the box is periodic along {up!r}, and has no height there; name another axis=, "
            "or bounds= along it"
        )
    measure = Measure(
        names=_measured(names, rate),
        regions=regions,
        by=by,
        groups=groups,
        depth=scene.layer_depth,
        min_contacts=int(min_contacts),
        iterative=rattlers == "iterative",
        max_connectivity=int(max_connectivity),
        force_bins=_force_bins(force_bins),
        cell=cell,
        by_volume=mixing_weight == "volume",
        axis=up,
    )
    scene.require(sorted(measure.needs), f"microstructure ({', '.join(names)})")
    result = run(scene, measure, call=call, on_error=on_error)
    return _with_series(scene, result, names, rate, up)


def _check_cell(cell: float | Mapping[str, float], plane: str) -> None:
    edges = cell
    if not isinstance(edges, Mapping):
        edges = {plane[0]: edges}
    fits = all(a in [*plane] and is_positive(edge) for a, edge in edges.items())
    if not edges or not fits:
        raise ValueError(
            f"cell={cell!r}: expected the edge of a cell (m), such as three diameters, or edges by axis "
            f"such as {{{plane[-1]!r}: 0.01}} for layers"
        )


def _force_bins(edges: ArrayLike | None) -> NDArray:
    if edges is None:
        return FORCE_BINS
    bins = floats(edges)
    if bins.ndim != 1 or len(bins) < 2 or not ((np.diff(bins) > 0).all() and bins[0] >= 0):
        raise ValueError(
            f"force_bins={edges!r}: expected at least two increasing edges of f / <f>, such as np.logspace(-3, 1, 41)"
        )
    return bins


def _regions(bounds: Bounds | Mapping[str, Bounds] | None, plane: str) -> dict[str, Bounds]:
    """Bounds by name of the region; the name is empty where there is one region only."""
    regions: Any = {"": bounds or {}}
    if isinstance(bounds, Mapping) and any(isinstance(ends, Mapping) for ends in bounds.values()):
        regions = dict(bounds)
    for region in regions.values():
        fits = isinstance(region, Mapping) and region.keys() <= set(plane)
        if fits:
            edges = [floats(ends) for ends in region.values()]
            fits = all(ends.shape == (2,) and ends[0] < ends[1] for ends in edges)
        if not fits:
            raise ValueError(
                f"bounds={bounds!r}: expected (low, high) for axes of the scene ({', '.join(plane)}), for example "
                f"{{{plane[-1]!r}: (0.0, 0.1)}}, or several such mappings by name of the region"
            )
    return regions


def _rate_source(ds: xr.Dataset, rate: str | float | xr.DataArray | None) -> str | xr.DataArray:
    """Return the source of the strain rate: "box", "velocity", or the rate itself."""
    if rate is None:
        deforms = "box" in ds and "lattice" not in ds and ds.sizes.get("time", 0) > 1
        if "lattice_velocity" in ds or (deforms and times_are_known(ds)):
            return "box"
        return "velocity"
    if isinstance(rate, str):
        if rate not in get_args(RateSource):
            raise ValueError(f"strain_rate={rate!r}: expected a rate (s-1), 'box' or 'velocity'")
        if rate == "box" and "lattice_velocity" in ds:
            return rate
        if rate == "box" and ("box" not in ds or ds.sizes.get("time", 0) < 2):
            raise ValueError(
                "strain_rate='box' needs a box and two steps; give the rate (s-1), or take 'velocity'"
            )
        if rate == "box" and "lattice" in ds:
            raise ValueError(
                "strain_rate='box': how fast this tilted box shears is not known; give shear_rate= when the scene is "
                "opened, or take 'velocity'"
            )
        return rate
    if isinstance(rate, xr.DataArray):
        return rate
    hint = ", or a DataArray of one for each time"
    check("strain_rate", rate, FINITE, "s-1", hint=hint)
    return xr.DataArray(float(rate))


def _choose(
    scene: Scene, quantities: str | Sequence[str] | None, rate: str | xr.DataArray, by: str | None
) -> tuple[str, ...]:
    """Names that were asked for, or all that the scene allows."""
    if isinstance(quantities, str):
        quantities = [quantities]
    if quantities is not None:
        names = list(quantities)
        if not names:
            raise ValueError(
                f"quantities={quantities!r}: expected at least one; leave it out for all that the scene allows"
            )
        for name in names:
            if name not in NAMES:
                raise ValueError(
                    unknown(
                        "quantity",
                        name,
                        NAMES,
                        "others are listed on the page on microstructure",
                        _OTHER_NAMES,
                    )
                )
        mixing = [name for name in names if name in QUANTITIES and QUANTITIES[name].of_phases]
        if mixing and by is None:
            raise ValueError(
                f"{', '.join(mixing)}: say which phases are mixed with by=, for example by='species'"
            )
        if set(names) & set(STRAIN):
            scene.require(("box",), "strain of the box")
        return tuple(dict.fromkeys(names))
    allowed = []
    for name in NAMES:
        parts = [QUANTITIES[part] for part in _measured([name], rate)]
        has_all = all(set(part.needs) <= scene.columns.keys() for part in parts)
        of_phases = any(part.of_phases for part in parts)
        if has_all and not of_phases and (name not in STRAIN or "box" in scene.columns):
            allowed.append(name)
    return tuple(allowed)


def _measured(names: Sequence[str], rate: str | xr.DataArray) -> tuple[str, ...]:
    """Quantities to measure step by step for these names; a rate that comes from elsewhere is not among them."""
    measured: list[str] = []
    for name in names:
        if name in INERTIAL:
            measured += [INERTIAL[name], "particle_density", "mean_stress", "strain_rate"]
        elif name not in STRAIN:
            measured.append(name)
    if not _is(rate, "velocity"):
        measured = [name for name in measured if name != "strain_rate"]
    return tuple(dict.fromkeys(measured))


def _is(rate: str | xr.DataArray, source: str) -> bool:
    return isinstance(rate, str) and rate == source


def _rate_of_lattice(ds: xr.Dataset, plane: str) -> xr.DataArray:
    """Return the deviatoric strain rate of the flow that moves the vectors of a lattice as they move."""
    axes = ["xyz".index(a) for a in plane]
    vectors = ds["lattice"].to_numpy()[..., axes, :][..., axes]
    velocities = ds["lattice_velocity"].to_numpy()[..., axes, :][..., axes]
    is_period = np.isfinite(vectors)
    vectors = np.where(is_period, vectors, np.eye(len(axes)))
    gradient = np.linalg.solve(vectors, np.where(is_period, velocities, 0.0))
    rate = (gradient + gradient.swapaxes(-1, -2)) / 2
    trace = np.trace(rate, axis1=-2, axis2=-1)[..., None, None]
    deviator = rate - trace / len(axes) * np.eye(len(axes))
    factor = {2: 2, 3: 2 / 3}[len(axes)]
    values = np.sqrt(factor * (deviator**2).sum(axis=(-2, -1)))
    return xr.DataArray(values, dims=ds["lattice"].dims[:-2])


def _with_series(
    scene: Scene,
    result: xr.Dataset,
    names: Sequence[str],
    rate: str | xr.DataArray,
    axis: str,
) -> xr.Dataset:
    """Add what takes the whole series: strains, the strain rate of the box, inertial numbers."""
    ds = scene.ds
    setup = scene.setup
    takes_rate = not {"strain_rate", *INERTIAL}.isdisjoint(names)
    is_of_box = takes_rate and _is(rate, "box")
    if "box" in ds and (set(STRAIN) & set(names) or is_of_box):
        lengths = ds["box"].isel(bound=1) - ds["box"].isel(bound=0)
        lengths = lengths.sel(component=list(setup.plane))
        first = lengths
        if lengths.sizes["time"]:
            first = lengths.isel(time=0, drop=True)
        stretch = xr.ufuncs.log(lengths / first)
        total = stretch.sum("component", skipna=False)
        axial = stretch.sel(component=axis, drop=True)
        for name, logarithm in (("volumetric_strain", total), ("axial_strain", axial)):
            values = labelled(0.0 - logarithm, "1", STRAIN[name])
            result[name] = values.assign_attrs(measure="logarithmic")
        if is_of_box and "lattice_velocity" in ds:
            rate = _rate_of_lattice(ds, setup.plane)
        elif is_of_box:
            require_times(ds, "the strain rate of the box")
            if stretch.chunks:  # finite differences reach over chunks; a box is six numbers a step
                stretch = stretch.chunk(time=-1)
            rates = stretch.differentiate("time")
            deviator = rates - rates.mean("component")
            factor = {2: 2, 3: 2 / 3}[setup.dimension]
            rate = xr.ufuncs.sqrt(factor * (deviator**2).sum("component", skipna=False))
    if isinstance(rate, xr.DataArray):
        row = QUANTITIES["strain_rate"]
        rate = labelled(rate, units_in(row.units, setup.unit_system), row.long_name)
        result["strain_rate"] = rate.assign_attrs(formula=row.formula)
    for name in set(INERTIAL) & set(names):
        pressure = result["mean_stress"]
        root = xr.ufuncs.sqrt(result["particle_density"] / pressure.where(pressure > 0))
        number = xr.ufuncs.fabs(result["strain_rate"]) * result[INERTIAL[name]] * root
        size = INERTIAL[name]
        number = labelled(
            number.transpose(*pressure.dims),
            "1",
            f"inertial number with {size}, of the contact stress",
        )
        formula = f"strain_rate {size} sqrt(particle_density / mean_stress)"
        result[name] = number.assign_attrs(formula=formula)
    return result[list(names)]
