"""Change the package in one place at a time, and check that a test fails: formulas, signs, indices, comparisons.

Run from the root of a clone, in the environment of the tests::

    python -m tests.mutations [--only WORD]

Each row of `TABLE` is run on a copy of the package, with the tests that should catch it. First all these tests are run
on the unchanged copy. The exit code is 1 if a mutation survives. `--only` runs the rows with this word in the file or
in the text.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COPIED = (
    "xcg",
    "tests",
    "docs",
    "examples",
    "pyproject.toml",
    "README.md",
    "CITATION.cff",
    "LICENSE",
)
LONGEST = 900  # seconds; a loop that does not end is caught as well


class Mutation(NamedTuple):
    """Change of a file of the package: `old`, which occurs once in it, becomes `new`; names of tests that see it."""

    file: str
    old: str
    new: str
    tests: str


TABLE = [
    # --- compiled ---
    Mutation(
        "compiled/smoothing.py", "return -12.0 * p * p", "return -6.0 * p * p",
        "test_derivatives_equal_finite_differences",
    ),
    Mutation(
        "compiled/lines.py", "lower = -lower", "lower = lower",
        "test_segment_integrals_equal_quadrature",
    ),
    Mutation(
        "compiled/lines.py", "_lucy_profile(a, abs(a))", "_lucy_profile(a, a)",
        "test_segment_integrals_equal_quadrature",
    ),
    Mutation(
        "compiled/polynomials.py", "(n + 3.0) / (n + 2.0) * h2 * odd", "(n + 2.0) / (n + 1.0) * h2 * odd",
        "test_marginals_are_integrals_over_the_other_axes",
    ),
    Mutation(
        "compiled/points.py", "1.0, (wy * uy, wy * uz, wz * uz, w * w)", "1.0, (wy * uy, wx * uz, wz * uz, w * w)",
        "test_deposit_of_points_equals_its_reference",
    ),
    Mutation(
        "compiled/points.py", "(mass * other[k])", "other[k]",
        "test_degrees_of_freedom_left_by_a_fit_equal_brute_force",
    ),
    Mutation(
        "compiled/segments.py", "end = start - branch", "end = start + branch",
        "test_segments_listed_anew_have_the_same_bits",
    ),
    Mutation(
        "compiled/reach.py", "math.ceil((first - x - high) / period)", "math.ceil((first - x + high) / period)",
        "test_support_larger_than_the_box_counts_all_images",
    ),
    Mutation(
        "compiled/gradient_fit.py", "rows[count, n] > rank + 1", "rows[count, n] > rank",
        "test_fits_to_no_grain_one_grain_or_damaged_sums_are_nan test_grains_in_a_plane_give_no_gradient_across_it",
    ),
    Mutation(
        "compiled/matrices.py", "second[n] = sine[n] * a + cosine[n] * b", "second[n] = cosine[n] * b - sine[n] * a",
        "test_eigenvalues",
    ),
    Mutation(
        "compiled/geometry.py", "(half - _disc_in_quarter(a, -b))", "(half + _disc_in_quarter(a, -b))",
        "test_areas_by_quadrature",
    ),
    Mutation(
        "compiled/polynomials.py", "r2 * (0.375 * r2 + 0.5 * h2)", "r2 * (0.375 * r2 - 0.5 * h2)",
        "test_segment_integrals_equal_quadrature",
    ),
    Mutation(
        "compiled/program.py", "rows[a, k] - rows[b, k]", "rows[b, k] - rows[a, k]",
        "test_operations_on_rows_equal_those_of_numpy",
    ),
    Mutation(
        "compiled/smoothing.py", "* y + c) * y + d", "* y + d) * y + c",
        "test_sums_in_a_volume_take_a_gaussian_to_rounding",
    ),
    Mutation(
        "compiled/polynomials.py", "(3.6 + 3.2 * q2)", "(3.6 - 3.2 * q2)",
        "test_marginals_are_integrals_over_the_other_axes",
    ),
    Mutation("compiled/elementary.py", "math.pi - found", "math.pi + found", "test_angles"),
    Mutation(
        "readers/engines/mfix.py", "half_axis * arrays[_SCALE]", "half_axis",
        "test_half_axes_of_superquadrics_are_those_of_the_phase_times_the_scale",
    ),
    Mutation(
        "readers/engines/mercury_restart.py", "/ float(normal[axis])", "* float(normal[axis])",
        "test_periods_are_those_of_periodic_boundaries",
    ),
    Mutation(
        "readers/order.py", "if not len(ids) or np.isin(", "if np.isin(",
        "test_steps_of_a_table_without_ids_are_not_compared",
    ),
    Mutation(
        "readers/ends.py", "(filled[0], filled[-1], filled[1])", "(filled[0], filled[-1])",
        "test_series_in_which_grains_recur_are_silent",
    ),
    Mutation(
        "readers/column_units.py", "of_unit**exponent", "of_unit**sign", "test_units_of_columns_have_factors_to_si",
    ),
    Mutation(
        "readers/column_units.py", "2 * math.pi / 60", "math.pi / 60", "test_units_of_columns_have_factors_to_si",
    ),
    Mutation(
        "readers/named_columns.py", "not in ((0, 0, 0), unit.powers)", "not in ((0, 0, 0), powers)",
        "test_units_of_another_quantity_are_named",
    ),
    Mutation(
        "readers/files/table.py", "compute.list_element(values, k)", "compute.list_element(values, 0)",
        "test_lists_in_parquet_are_vectors",
    ),
    Mutation(
        "fields/support.py", "plan.kernel.squared_integral(seen), count))", "plan.kernel.squared_integral(seen), 1e9))",
        "test_a_node_sees_no_more_grains_than_there_are",
    ),
    Mutation(
        "readers/named_columns.py", "return unit.factor", "return 1.0",
        "test_units_in_names_are_converted_unless_units_are_given",
    ),
    Mutation(
        "readers/engines/vtk.py", "frame[name] = frame[name] * factor", "frame[name] = frame[name]",
        "test_units_of_arrays_are_converted",
    ),
    Mutation(
        "scene/schema.py", "tuple(factor * component for", "tuple(component / factor for",
        "test_gravity_in_the_units_of_the_data_warns",
    ),
    Mutation(
        "scene/complete.py", "beta(e1 / 2 + 1, e1)", "beta(e1 / 2, e1)",
        "test_axes_of_superquadrics_are_those_of_the_code_whose_columns_they_are",
    ),
    Mutation(
        "readers/from_table.py", '"contact_force_z": along * z', '"contact_force_z": 0.0 * z',
        "test_magnitudes_in_tables_follow_the_centres",
    ),
    Mutation(
        "readers/columns.py", "0.5) for axis", "1.0) for axis", "test_dumps_of_superquadrics_need_no_names",
    ),
    Mutation(
        "compiled/pairs.py", "touch = values[j, 3] + ri + skin", "touch = values[j, 3] + ri",
        "test_touching_pairs_are_found_only_with_a_skin",
    ),
    Mutation(
        "compiled/contacts.py", "if here_i and (here_j or j < 0):", "if here_i and here_j:",
        "test_the_backbone_is_left_after_removing_rattlers",
    ),
    Mutation(
        "compiled/chains.py", "branches[k] += links[p] > 2", "branches[k] += links[p] >= 2",
        "test_a_branching_chain_is_one_chain",
    ),
    Mutation(
        "compiled/arrays.py", "half = (one << (drop - one)) - one", "half = one << (drop - one)",
        "test_bits_are_rounded_to_nearest_even",
    ),
    Mutation(
        "compiled/text.py", "is_nearest = is_nearest and also and above == value", "is_nearest = is_nearest and also",
        "test_numbers_are_the_nearest_float64",
    ),
    Mutation(
        "compiled/rings.py", "found = 2.0 * (sums", "found = 1.0 * (sums",
        "test_temperatures_of_rings_are_without_bias",
    ),
    Mutation(
        "compiled/rings.py", "2.0 * along * d", "1.0 * along * d",
        "test_the_heat_flux_of_a_ring_by_brute_force",
    ),
    Mutation(
        "compiled/rings.py", "+ square * mass * d[i]", "- square * mass * d[i]",
        "test_the_heat_flux_of_a_ring_by_brute_force",
    ),
    Mutation(
        "compiled/rings.py", "tensor[k + apart] = c * y - s * x", "tensor[k + apart] = c * y + s * x",
        "test_rigid_rotation_has_its_velocity_vorticity_and_no_temperature",
    ),
    Mutation(
        "compiled/rings.py", "+= d[i] * record[flow.offset[j]]", "-= d[i] * record[flow.offset[j]]",
        "test_rigid_rotation_has_its_velocity_vorticity_and_no_temperature",
    ),
    # --- scene ---
    Mutation(
        "scene/contacts.py", "-self.force[wall_i]", "self.force[wall_i]",
        "test_walls_may_come_first_or_second_and_particles_may_be_the_first",
    ),
    Mutation("scene/contacts.py", "* (1 + 1e-12)", "* (1 - 1e-12)", "test_equal_forces_are_all_weak"),
    Mutation(
        "scene/complete.py", '{"disc": 8, "sphere": 10}', '{"disc": 10, "sphere": 8}',
        "test_moments_of_inertia_of_spheres_and_discs",
    ),
    Mutation(
        "scene/bodies.py", "lattice.drift(offset - apart)", "lattice.drift(apart - offset)",
        "test_bodies_across_a_sheared_edge_have_the_velocity_of_one_place",
    ),
    Mutation(
        "scene/lattice.py", "rates[k] -= numbers @ rates[others]", "rates[k] += numbers @ rates[others]",
        "test_homogeneous_shear_has_one_gradient_and_no_temperature_up_to_the_edges",
    ),
    Mutation(
        "scene/sizes.py", "np.searchsorted(up_to, 0.5 * total)", "np.searchsorted(up_to, 0.4 * total)",
        "test_half_of_the_mass_lies_in_grains_up_to_d50",
    ),
    Mutation(
        "fields/grids/frames.py", 'attrs["gravity"] = axes @', 'attrs["gravity"] = axes.T @',
        "test_gravity_turns_with_the_frame",
    ),
    # --- steps ---
    Mutation(
        "steps/faults.py", 'kind == "f" else PADDING', 'kind == "f" else 0',
        "test_whole_numbers_of_a_skipped_step_are_padding",
    ),
    Mutation(
        "steps/mapping.py", "set.intersection(*edges)", "set.union(*edges)",
        "test_chunks_follow_those_of_all_variables",
    ),
    Mutation(
        "steps/labels.py", "numbers[skipped.to_numpy()]", "numbers[~skipped.to_numpy()]",
        "test_a_step_in_memory_that_cannot_be_computed_is_skipped",
    ),
    Mutation(
        "steps/mapping.py", "finest = max((", "finest = min((", "test_tasks_take_the_finest_chunks_of_their_variables",
    ),
    Mutation(
        "steps/mapping.py", "(bar.total - first) * done", "bar.total * done",
        "test_tasks_count_the_steps_that_are_left",
    ),
    # --- fields/sums ---
    Mutation(
        "fields/sums/kernels.py", "- 4 * math.pi * s**2 * tail", "- 2 * math.pi * s**2 * tail",
        "test_kernels_and_marginals_integrate_to_one",
    ),
    Mutation(
        "fields/sums/kernels.py", "(dimension + 2 * n)", "(dimension + n)", "test_shifted_gaussians_of_any_cutoff",
    ),
    Mutation(
        "fields/sums/moments.py", "c.branch_i - c.branch_j)", "c.branch_i + c.branch_j)",
        "test_fields_are_their_definitions",
    ),
    Mutation(
        "fields/sums/moments.py", "AT_LIMIT = 0.999", "AT_LIMIT = 0.9",
        "test_redundancy_factor_of_a_lattice test_sums_over_contacts_equal_brute_force",
    ),
    Mutation(
        "fields/sums/moments.py", '"square_spread": 2}', '"square_spread": 1}',
        "test_degrees_of_freedom_left_by_a_fit_equal_brute_force",
    ),
    Mutation(
        "fields/passes.py", "np.where(mixed[contact], 0.5, 1.0)", "np.where(mixed[contact], 1.0, 1.0)",
        "test_phases_add_up",
    ),
    Mutation(
        "fields/passes.py", "(self.position - lattice.middle) @ gradient.T", "self.position @ gradient.T",
        "test_an_average_across_the_shear_is_that_in_the_middle_of_the_box",
    ),
    Mutation(
        "fields/evaluate.py", "float(factor[group])", "float(factor[0])",
        "test_a_program_gives_what_the_registry_gives",
    ),
    Mutation(
        "fields/passes.py", "phase[row[at]] * others + phase[partner[at]]",
        "phase[partner[at]] * others + phase[row[at]]", "test_exchange_between_phases_equals_brute_force",
    ),
    Mutation(
        "fields/passes.py", "(columns, -1 / arrays.plan.cutoff_of_group)",
        "(columns, 1 / arrays.plan.cutoff_of_group)",
        "test_kernel_gradient_is_the_derivative_of_velocity",
    ),
    Mutation(
        "fields/passes.py", "arrays.plan.cutoff_of_group ** CUTOFF_POWERS[name]", "1.0",
        "test_linear_flow_is_exact_with_two_widths",
    ),
    Mutation(
        "fields/passes.py", "same[name] = float(columns[0, 0])", "same[name] = 1.0",
        "test_equal_diameters_take_one_column",
    ),
    Mutation(
        "fields/passes.py", "return bool((values == values[0]).all())", "return True",
        "test_fields_of_any_scene_equal_brute_force",
    ),
    Mutation(
        "fields/passes.py", "(contacts.j, contacts.i, -1.0)", "(contacts.j, contacts.i, 1.0)",
        "test_exchange_between_phases_equals_brute_force",
    ),
    Mutation(
        "fields/passes.py", "arrays.column(moment, images, contact) * share[:, None]",
        "arrays.column(moment, images, contact)",
        "test_phases_add_up",
    ),
    Mutation(
        "fields/passes.py", "translations(2.0, self.source)", "translations(1.0, self.source)",
        "test_support_larger_than_the_box_counts_all_images",
    ),
    Mutation(
        "fields/passes.py", "self.phase[c.j[mixed]]", "self.phase[c.i[mixed]]",
        "test_sums_over_contacts_equal_brute_force",
    ),
    Mutation(
        "fields/passes.py", "np.repeat(plan.cutoff_of_group == cutoff, others)",
        "np.tile(plan.cutoff_of_group == cutoff, others)",
        "test_forces_between_phases_have_the_kernel_of_the_phase_they_act_on",
    ),
    Mutation(
        "fields/sums/nodes.py", "self.shape[1] + y[:, None]) * self.shape[2] + z",
        "self.shape[1] + y[:, None]) * self.shape[1] + z",
        "test_threads_and_blocks_change_no_bit",
    ),
    Mutation(
        "fields/sums/nodes.py", "triple((np.array(self.high) - 1) * spacings)",
        "triple((np.array(self.high) - 2) * spacings)",
        "test_threads_and_blocks_change_no_bit",
    ),
    Mutation(
        "fields/sums/nodes.py", "np.where(nodes.active, period, np.inf) / cutoff",
        "np.where(nodes.active, period, np.inf)",
        "test_fields_in_3d_equal_brute_force",
    ),
    Mutation(
        "fields/sums/nodes.py", "self.upper + reach, np.inf", "self.upper, np.inf",
        "test_fields_equal_those_of_another_basis_and_other_images",
    ),
    Mutation(
        "fields/sums/nodes.py", "argmin(axis=0) == 0", "argmin(axis=0) == 1",
        "test_the_stress_of_a_contact_with_a_far_partner_is_exact_near_the_mesh",
    ),
    Mutation(
        "fields/sums/nodes.py", "reach / self.period + 1.0", "reach * self.period + 1.0",
        "test_thousands_of_images_raise_where_they_are_paired",
    ),
    Mutation(
        "fields/sums/nodes.py", "n * self.spacing.get(a, 0.0)", "(n - 1) * self.spacing.get(a, 0.0)",
        "test_finite_differences_wrap_around_a_period",
    ),
    Mutation(
        "fields/formulas/tracing.py", "register[operand] >= kept", "register[operand] >= 0",
        "test_programs_of_any_fields_in_any_order",
    ),
    Mutation(
        "fields/formulas/tracing.py", "kept += FOUND", "kept += 1",
        "test_fits_by_eigenvectors_equal_those_of_the_loop",
    ),
    Mutation(
        "fields/formulas/tracing.py", "register[operands[1]] + operands[0]", "register[operands[1]]",
        "test_a_program_gives_what_the_registry_gives",
    ),
    Mutation(
        "fields/formulas/tracing.py", "complete.setdefault(max(numbers)", "complete.setdefault(min(numbers)",
        "test_programs_of_any_fields_in_any_order",
    ),
    Mutation(
        "fields/formulas/tracing.py", "inputs_of[0], inputs_of[-1]", "inputs_of[-1], inputs_of[0]",
        "test_a_program_gives_what_the_registry_gives",
    ),
    Mutation(
        "fields/passes.py", "values[:, 0] *= share", "values[:, 0] *= 1.0",
        "test_variables_of_contacts_are_sums_at_the_contact_points",
    ),
    Mutation(
        "fields/passes.py", 'frame["velocity"] + drift', 'frame["velocity"] - drift',
        "test_grains_written_by_images_that_move_give_the_same_fields",
    ),
    Mutation(
        "fields/sums/nodes.py", "lower = self.lower - _MARGIN", "lower = self.lower + _MARGIN",
        "test_the_far_part_of_a_slanted_branch_does_not_matter",
    ),
    Mutation(
        "fields/sums/nodes.py", "part * branch)", "branch)",
        "test_the_part_of_a_far_branch_along_a_periodic_axis_is_that_near_the_mesh",
    ),
    # --- fields/grids ---
    Mutation(
        "fields/grids/grid.py", "first += 0.5 * spacing", "first += 0.4 * spacing",
        "test_cells_of_a_periodic_axis_begin_at_its_edge",
    ),
    Mutation(
        "fields/grids/walls.py", "normal = self._sign * (vectors * radial)",
        "normal = -self._sign * (vectors * radial)", "test_hydrostatic_pressure_in_a_cylinder",
    ),
    Mutation(
        "fields/grids/walls.py", "(np.hypot(x, y) + self.radius)\n        with",
        "(np.hypot(x, y) - self.radius)\n        with", "test_the_accessible_fraction_near_walls_equals_brute_force",
    ),
    Mutation(
        "fields/grids/walls.py", "if flip:", "if not flip:",
        "test_distances_from_triangles_equal_those_of_brute_force test_surfaces_are_read_from_files",
    ),
    # --- fields/formulas ---
    Mutation(
        "fields/formulas/rows/energy.py", "0.5 * ratio(f.inertia_density", "0.25 * ratio(f.inertia_density",
        "test_rotational_temperature_is_unknown_where_the_mean_leaves_less_than_half_a_grain",
    ),
    Mutation(
        "fields/formulas/rows/energy.py", "- square * s.mass)[..., None] * b", "+ square * s.mass)[..., None] * b",
        "test_fields_are_their_definitions test_heat_flux_of_a_fast_frame",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "0.5 * ratio(s.mass, s.count)", "0.25 * ratio(s.mass, s.count)",
        "test_two_grains_have_a_temperature_while_their_masses_are_alike",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "(2 * double_dot(inverse, own) - mean - shared)",
        "(2 * double_dot(inverse, own) - mean + shared)", "test_degrees_of_freedom_left_by_a_fit_equal_brute_force",
    ),
    Mutation(
        "fields/formulas/rows/contacts.py", "{2: 0.5, 3: 1.5}[o.dimension]", "{2: 1.5, 3: 0.5}[o.dimension]",
        "test_anisotropies_of_a_plane",
    ),
    Mutation(
        "fields/formulas/rows/contacts.py", "(d - 1) * s.load_bearing_sliding", "d * s.load_bearing_sliding",
        "test_redundancy_factor_of_a_lattice test_sums_over_contacts_equal_brute_force",
    ),
    Mutation(
        "fields/formulas/rows/displacement.py", "- b * (d * j - g * h)", "+ b * (d * j - g * h)",
        "test_affine_deformation_is_exact",
    ),
    Mutation(
        "fields/formulas/rows/errors.py", "steady - 4 * share * whole", "steady - 2 * share * whole",
        "test_a_steady_part_counts_as_far_as_it_exceeds_its_noise",
    ),
    Mutation(
        "fields/formulas/rows/errors.py", "+ 2 * f._covariance * f._slopes", "- 2 * f._covariance * f._slopes",
        "test_errors_of_linear_fields_by_propagation",
    ),
    Mutation(
        "fields/formulas/rows/errors.py", "- 2 * theta[..., i, j] * slopes", "+ 2 * theta[..., i, j] * slopes",
        "test_errors_of_linear_fields_by_propagation",
    ),
    Mutation(
        "fields/formulas/rows/errors.py", "(o.dimension + 1) * f._left", "(o.dimension - 1) * f._left",
        "test_errors_are_the_scatter_of_draws",
    ),
    Mutation(
        "fields/formulas/block_errors.py", "* np.sqrt(of_others.sizes[dim] - 1)", "* np.sqrt(of_others.sizes[dim])",
        "test_errors_of_few_samples_are_their_scatter_over_the_root_of_their_number",
    ),
    Mutation(
        "fields/formulas/mean_sums.py", "drift + weight * shift", "weight * shift",
        "test_errors_of_the_kinetic_stress_are_those_of_averages_without_each_step",
    ),
    Mutation(
        "fields/formulas/mean_sums.py", "moved = first - weight * mean", "moved = first",
        "test_errors_of_the_kinetic_stress_are_those_of_averages_without_each_step",
    ),
    Mutation(
        "fields/formulas/floors.py", "of_contacts) / of_contacts", "of_contacts)",
        "test_angles_of_contacts_whose_stress_and_fabric_have_one_axis",
    ),
    Mutation(
        "fields/formulas/doubts.py", "1 + (1 - repeated) * (steps - 1)", "1 + repeated * (steps - 1)",
        "test_steps_that_are_written_again_are_counted",
    ),
    Mutation(
        "fields/pressures.py", "np.diff(means, axis=0) * _SLICES / extent", "np.diff(means, axis=0) / extent",
        "test_a_jet_is_no_fluctuation",
    ),
    Mutation(
        "fields/advice.py", "slope = float(x @ v) / squares", "slope = float(x @ v)",
        "test_a_compressed_box_holds_the_flow_of_its_images",
    ),
    Mutation(
        "fields/formulas/mean_sums.py", 'sums["velocity/shift"] - weight * mean', 'sums["velocity/shift"]',
        "test_errors_of_the_flux_of_a_phase_are_those_of_averages_without_each_step",
    ),
    Mutation(
        "fields/formulas/mean_sums.py", "(of_bulk - mean).where", "of_bulk.where",
        "test_a_window_of_one_step_is_the_step_and_a_fast_frame_loses_no_digits",
    ),
    Mutation(
        "fields/formulas/rows/energy.py", "-0.5 * trace(f.covariance", "0.5 * trace(f.covariance",
        "test_kinetic_stress_of_an_average_is_about_the_averaged_velocity",
    ),
    Mutation(
        "fields/formulas/averages.py", "average.to_sums(f, dims).mean", "average.to_sums(f).mean",
        "test_blocks_of_nodes_keep_mass_and_hold_ratios_of_sums",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "s.kinetic + outer(b, s.momentum)", "s.kinetic",
        "test_blocks_of_nodes_keep_mass_and_hold_ratios_of_sums test_fields_equal_the_columns_of_mercury",
    ),
    Mutation(
        "fields/formulas/doubts.py", "(count - 2) / (count - 2 + t**2)", "(count - 2) / (count - 2 + t)",
        "test_a_trend_warns_where_it_exceeds_three_of_its_errors",
    ),
    Mutation(
        "fields/formulas/doubts.py", "weight.sum(dim) ** 2 / squares", "weight.sum(dim) / squares",
        "test_means_of_few_steps_warn_of_the_share_within_two_errors test_means_of_many_steps_are_silent",
    ),
    Mutation(
        "fields/formulas/doubts.py", "np.abs(middle) < error", "np.abs(middle) > error",
        "test_an_unsure_sign_of_the_nematic_order_warns_and_has_no_bias",
    ),
    Mutation(
        "fields/pressures.py", "np.maximum(of_line, _beyond(", "np.minimum(of_line, _beyond(",
        "test_a_weak_shear_of_few_grains_is_known_by_its_mean_slope",
    ),
    Mutation(
        "fields/advice.py", "shares = by_component / np.maximum(normal, mean)", "shares = by_component / normal",
        "test_few_grains_without_flow_and_a_component_that_is_small_are_silent",
    ),
    Mutation(
        "fields/formulas/floors.py", "math.sqrt(2 * support.contacts)", "math.sqrt(support.contacts)",
        "test_tangential_forces_of_independent_contacts",
    ),
    Mutation(
        "fields/pressures.py", "length.std() / length.mean()", "length.std()",
        "test_the_floors_of_branches_and_tangential_forces_follow_from_the_contacts_of_the_step",
    ),
    Mutation(
        "fields/formulas/doubts.py", "[FLOOR] / math.sqrt(places)", "[FLOOR] / places",
        "test_the_floor_of_a_profile_is_that_of_the_marginal",
    ),
    Mutation(
        "fields/formulas/doubts.py", "[FLOOR] / math.sqrt(number)", "[FLOOR] / number",
        "test_norms_of_averages_of_few_grains_warn_of_their_floor",
    ),
    Mutation(
        "fields/advice.py", "share = total / (total + kinetic)", "share = total / kinetic",
        "test_a_temperature_that_holds_the_flow_along_an_averaged_axis_names_its_share",
    ),
    Mutation(
        "fields/advice.py", "kinetic = float(parts.about_flow.sum())", "kinetic = float(parts.kinetic.sum())",
        "test_waves_of_a_homogeneous_shear_are_fluctuations",
    ),
    Mutation(
        "fields/formulas/doubts.py", "(reached & values.isnull())", "values.notnull()",
        "test_averaged_temperatures_of_phases_that_are_unknown_warn_of_their_share",
    ),
    Mutation(
        "fields/formulas/block_errors.py", "bias = (count - 1) * deviation.mean", "bias = count * deviation.mean",
        "test_bias_of_kinetic_stress_is_that_of_a_variance",
    ),
    Mutation(
        "fields/formulas/block_errors.py", "(of_others[name] + norm)", "(of_others[name] - norm)",
        "test_the_square_of_a_norm_without_its_bias_is_that_of_the_mean_less_its_variance",
    ),
    Mutation(
        "fields/formulas/doubts.py", "error > angle / 2", "error < angle / 2",
        "test_angles_that_are_noise_warn_and_have_no_bias",
    ),
    Mutation(
        "fields/formulas/doubts.py", "bias > _NOISY * norm", "bias < _NOISY * norm",
        "test_norms_that_are_more_noise_than_truth_warn_of_both_values",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "(2 * dot(across, first) / mass +", "(dot(across, first) / mass +",
        "test_degrees_of_freedom_left_by_a_fit_equal_brute_force",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "own + 2 * double_dot(inverse, about(", "own + double_dot(inverse, about(",
        "test_degrees_of_freedom_left_by_a_fit_equal_brute_force",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "rest - rows[k][m][..., None] * temperature", "rest",
        "test_the_bulk_is_the_mean_by_mass_and_negative_temperatures_are_nan",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "pivot = rows[k][k] + absent[k]", "pivot = rows[k][k]",
        "test_phases_that_are_absent_leave_the_others_known",
    ),
    Mutation(
        "fields/formulas/rows/flow.py", "f.granular_temperature * mean_of(f.density, f.number_density)",
        "f.granular_temperature * f.density", "test_temperatures_of_a_mixture_are_those_of_its_phases",
    ),
    Mutation(
        "fields/pressures.py", "first + 2 * second * u + 3 * third * u * u", "first + second * u + third * u * u",
        "test_the_variation_of_the_flow_within_what_a_node_sees_is_named",
    ),
    Mutation(
        "fields/pressures.py", "variance / spread[k] ** 2", "variance / spread[k]",
        "test_a_linear_shear_adds_its_covariance_within_the_support",
    ),
    Mutation(
        "fields/pressures.py", "along -= along.mean(axis=0)", "along -= along[0]",
        "test_an_averaged_axis_adds_the_variance_of_the_flow_along_it",
    ),
    Mutation(
        "fields/pressures.py", "kinetic * (kinetic > least)", "kinetic",
        "test_flows_without_fluctuations_have_no_noise",
    ),
    Mutation(
        "analysis/wall_stress.py", "beside.any() and is_flat", "beside.any()",
        "test_a_rough_wall_is_no_other_wall",
    ),
    Mutation(
        "fields/pressures.py", "velocity[contacts.j] - of_image", "velocity[contacts.j]",
        "test_sheared_images_in_contact_do_not_fluctuate",
    ),
    Mutation(
        "fields/formulas/floors.py", "min(_SHAKEN, support.shaken)", "_SHAKEN",
        "test_the_noise_of_inertial_numbers_is_that_of_the_fluctuations_of_the_step",
    ),
    Mutation(
        "fields/support.py", "math.prod(length_along(scene, a, size) for a in plan.extent)",
        "_averaged_over(scene, plan)", "test_empty_parts_of_a_box_hold_no_grains",
    ),
    Mutation(
        "fields/advice.py", "contacts=_OF_LATTICE", "contacts=support.contacts",
        "test_contacts_of_a_lattice_have_no_noise",
    ),
    Mutation(
        "fields/pressures.py", "* rows / every", "* rows", "test_pressures_of_a_crystal_that_fluctuates",
    ),
    Mutation(
        "fields/advice.py", "share = added / (added + true)", "share = added",
        "test_no_variation_is_named_of_gases_sheared_boxes_and_slow_flows",
    ),
    Mutation(
        "fields/advice.py", "/ support.grains < _BIAS", "< _BIAS", "test_warnings_about_mixtures_name_the_way_out",
    ),
    Mutation(
        "fields/advice.py", "zip(self.plan.groups, shares[1:]", "zip(self.plan.groups, shares[:-1]",
        "test_the_share_of_unknown_temperatures_is_that_of_the_nodes",
    ),
    Mutation(
        "fields/support.py", "2 * math.pi * float(np.median", "float(np.median",
        "test_the_floor_in_rings_is_that_of_the_grains_around_the_axis",
    ),
    Mutation(
        "fields/advice.py", "if not lost > _CONSIDERABLE * true",
        "if not 1 / plan.support.grains > _CONSIDERABLE",
        "test_one_step_warns_of_the_kinetic_stress_that_it_lacks",
    ),
    Mutation(
        "fields/sums/moments.py", "high > _VARIED * low and", "high > low and",
        "test_strong_contacts_warn_where_the_mean_force_grows_with_depth",
    ),
    Mutation(
        "fields/sums/moments.py", "if not is_bounded or", "if",
        "test_strong_contacts_of_packings_without_gravity_and_along_periods_are_silent",
    ),
    Mutation(
        "fields/formulas/averages.py", "if np.any(gap)]", "if not np.any(gap)]",
        "test_runs_are_independent_samples_of_ratios_of_averaged_sums",
    ),
    Mutation(
        "fields/formulas/block_errors.py", "if independent:", "if not independent:",
        "test_a_drift_from_run_to_run_is_scatter",
    ),
    Mutation(
        "fields/formulas/block_errors.py", "~(next_error <= ROUNDING", "~(next_error <= 0 * ROUNDING",
        "test_steady_series_are_silent",
    ),
    Mutation(
        "fields/formulas/averages.py", "independent**0.5", "independent",
        "test_an_average_over_steps_has_the_larger_error_and_names_it",
    ),
    Mutation(
        "fields/formulas/rows/orientation.py", "-= 1 / (o.dimension - 1)", "-= 1 / o.dimension",
        "test_order_of_isotropic_directors_is_zero_and_of_aligned_ones_one",
    ),
    Mutation(
        "fields/formulas/rows/orientation.py", "where(is_planar, values[", "where(~is_planar, values[",
        "test_order_of_directors_spread_over_a_plane_is_minus_one_half",
    ),
    Mutation(
        "fields/formulas/floors.py", "(1 - 1 / dimension) / number", "(1 + 1 / dimension) / number",
        "test_anisotropy_of_independent_contacts",
    ),
    Mutation(
        "fields/formulas/floors.py", "math.sqrt(2 * _order(support))", "math.sqrt(_order(support))",
        "test_friction_of_contacts_with_forces_of_an_exponential_distribution",
    ),
    Mutation(
        "fields/support.py", "dimension + 1 - 2 / dimension", "dimension + 1",
        "test_shear_rate_of_independent_velocities",
    ),
    # --- fields ---
    Mutation(
        "fields/sums/kernels.py", "np.minimum(r, self.cutoff * (1 - 1e-12))", "r",
        "test_second_moments_of_kernels_and_their_marginals",
    ),
    Mutation(
        "fields/plan.py", 'if name != "definitions"', "if name",
        "test_plans_leave_their_definitions_behind_and_look_them_up_again",
    ),
    Mutation(
        "fields/plan.py", '"other_phase": self.phases', '"other_phase": len(self.groups)',
        "test_shapes_of_a_plan_are_those_of_its_result",
    ),
    Mutation(
        "fields/formulas/rules.py", "held |= dict.fromkeys(OF_COVARIANCE)", "held |= {}",
        "test_all_missing_sums_are_named_at_once",
    ),
    Mutation(
        "fields/presets/pysammos.py", "2.5 * chosen.cutoff + 0.5 *", "2.5 * chosen.cutoff + 1.0 *",
        "test_the_mesh_equals_that_of_pysammos",
    ),
    Mutation(
        "fields/accessible.py", "max(first for first, _ in bounds)", "max(first for first, _ in bounds[1:])",
        "test_surfaces_beyond_the_box_count_as_far_as_the_box",
    ),
    Mutation(
        "fields/grids/sections.py", "rise * (1.0 - beyond)", "rise * beyond",
        "test_a_silo_is_the_area_of_a_circle_times_the_fraction_beside_its_floor",
    ),
    Mutation(
        "fields/grids/sections.py", "is_open[:, None] ^ (", "~is_open[:, None] ^ (",
        "test_ends_of_open_parts_are_where_the_side_of_a_wall_changes",
    ),
    Mutation(
        "compiled/geometry.py", "facing[t] < 0.0", "facing[t] > 0.0",
        "test_a_pyramid_is_its_square_section_smeared_along_the_height",
    ),
    Mutation(
        "fields/grids/walls.py", "points[:, axis] = np.mean(self.span(axis))", "pass",
        "test_a_funnel_without_lids_is_open_above_its_cone_and_through_its_outlet",
    ),
    Mutation(
        "readers/files/table.py", "not in (0, ref.rows)", "in (0,)", "test_empty_cells_and_names_of_columns_raise",
    ),
    Mutation(
        "scene/phases.py", "return 0.0  # one", "return 1.0  # one", "test_few_grains_of_two_sizes_are_two_phases",
    ),
    Mutation(
        "fields/like.py", "/ (nodes.size - 1)", "/ nodes.size",
        "test_the_mesh_of_the_first_step_holds_for_all",
    ),
    Mutation(
        "fields/accessible.py", "0.5 + np.sign(distance) * between", "0.5 - np.sign(distance) * between",
        "test_the_accessible_fraction_beside_a_plane_is_a_polynomial",
    ),
    Mutation(
        "analysis/wall_stress.py", "distance.min(axis=0) <= task.within", "distance.min(axis=0) <= 2 * task.within",
        "test_contacts_farther_than_within_are_left_out",
    ),
    Mutation(
        "analysis/balance.py", "(8 * near - far)", "(8 * near + far)", "test_force_residual_falls_with_the_mesh",
    ),
    Mutation(
        "analysis/surfaces.py", "[turned] + 2 / 3", "[turned] + 1 / 3",
        "test_parts_of_a_triangle_have_its_area_and_its_centre",
    ),
    Mutation(
        "analysis/shallow.py", "_transport(sums) - transport", "_transport(sums) + transport",
        "test_the_stress_over_the_depth_leaves_out_the_profile_of_the_flow",
    ),
    Mutation(
        "analysis/surfaces.py", "min(last, high) - max(first, low)", "min(last, high) - first",
        "test_a_surface_counts_within_the_thickness_of_a_layer",
    ),
    Mutation(
        "analysis/shallow.py", 'surface["height"] - surface["base"]', 'surface["height"]',
        "test_the_thickness_is_that_of_the_slab_and_the_solid_depth_that_of_its_grains",
    ),
    Mutation(
        "fields/formulas/rows/errors.py", "4 / n * mixed - 2", "4 / n * mixed + 2",
        "test_errors_are_the_scatter_of_draws",
    ),
    Mutation(
        "fields/request.py", 'deviatoric: Deviatoric = "both"', 'deviatoric: Deviatoric = "stress"',
        "test_the_shear_rate_of_compression_is_zero_and_of_simple_shear_its_rate",
    ),
    Mutation(
        "fields/formulas/rows/rheology.py", "ratio(f.shear_stress, f.shear_rate)", "f.shear_stress * f.shear_rate",
        "test_the_granular_viscosity_is_the_relative_one_times_that_of_the_fluid",
    ),
    Mutation(
        "analysis/shallow.py", "len(matrix) - count - 1", "len(matrix) - count",
        "test_errors_of_a_line_through_three_heights",
    ),
    Mutation(
        "analysis/shallow.py", "/ (1 + steepness**2)", "/ (1 + steepness)",
        "test_errors_of_a_line_through_three_heights",
    ),
    Mutation(
        "analysis/slice_temperature.py", "1 - abs(m) / (sides + 1)", "1 - abs(m) / (sides + 2)",
        "test_temperatures_in_planes_equal_a_loop_over_grains",
    ),
    Mutation(
        "analysis/correlations.py", "share = (y0 - level)", "share = (level - y1)",
        "test_falls_to_interpolates_where_values_fall_below_a_level",
    ),
    Mutation(
        "analysis/diffusion.py", "first_step[indices[stay]] <= first", "first_step[indices[stay]] < len(counts)",
        "test_grains_that_come_back_count_as_new",
    ),
    Mutation(
        "analysis/derived.py", "position[stays] @ motion.gradient.T", "position[stays] @ motion.gradient",
        "test_velocities_across_edges_and_in_a_sheared_box",
    ),
    Mutation(
        "analysis/choose_width.py", "noise / frames**0.5", "noise / frames",
        "test_the_total_adds_the_bias_and_the_noise_of_the_mean_over_frames",
    ),
    Mutation(
        "analysis/choose_width.py", "math.sqrt(120)", "math.sqrt(480)",
        "test_the_spacing_adds_less_error_than_stated",
    ),
    # --- packing ---
    Mutation(
        "analysis/quantities.py", "{3: 2 / 3, 2: 2}[len(rate)]", "{3: 3 / 2, 2: 2}[len(rate)]",
        "test_shear_rates_from_velocities_and_as_given",
    ),
    Mutation(
        "analysis/mixing.py", "ratio(len(weight) - 1, count - 1)", "ratio(len(weight), count - 1)",
        "test_the_mean_over_all_arrangements_is_the_random_limit",
    ),
    Mutation(
        "analysis/network.py", "ends[0] <= ends[1], 1.0, -1.0", "ends[0] <= ends[1], -1.0, 1.0",
        "test_edges_are_sums_over_contacts",
    ),
    Mutation(
        "analysis/regions.py", "(position[:, k] < bounds[axis][1])", "(position[:, k] <= bounds[axis][1])",
        "test_a_region_holds_its_lower_bound_and_not_its_upper_one",
    ),
    Mutation(
        "analysis/pairs.py", "length < 3 * reach * np.maximum(edges, 1)", "length < 1 * reach * np.maximum(edges, 1)",
        "test_pairs_equal_those_of_brute_force",
    ),
    # --- structure and rheology ---
    Mutation(
        "fields/formulas/rows/contacts.py", "mean_of(s.force_slopes, s.pushing_contacts) / o.friction",
        "mean_of(s.force_slopes, s.pushing_contacts)", "test_sums_over_contacts_equal_brute_force",
    ),
    Mutation(
        "fields/formulas/rows/rheology.py", "low, high = order[first], order[first + 1]",
        "high, low = order[first], order[first + 1]",
        "test_normal_stress_differences_are_those_of_flow_gradient_and_vorticity",
    ),
    Mutation(
        "fields/formulas/rows/rheology.py", "(major - middle) + (major - minor)", "(major - middle)",
        "test_the_lode_angle_of_known_stresses",
    ),
    Mutation(
        "fields/formulas/rows/rheology.py", "f.stress, -f.shear_rate_tensor, o", "f.stress, f.shear_rate_tensor, o",
        "test_angles_between_axes_of_tensors_that_are_turned_against_each_other",
    ),
    Mutation(
        "scene/box.py", "(shares > _LARGE_SHARE)", "(shares > 2 * _LARGE_SHARE)",
        "test_grains_that_may_have_crossed_half_a_period_are_named",
    ),
    Mutation(
        "analysis/contact_history.py", "losses[1:].sum() / max", "0 * losses[1:].sum() / max",
        "test_steps_too_far_apart_for_contacts_are_named",
    ),
    Mutation(
        "analysis/fit_law.py", "(2 * freedom) ** -0.5", "freedom ** -0.5",
        "test_fits_of_few_points_say_how_uncertain_their_errors_are",
    ),
    Mutation(
        "analysis/microstructure.py", "np.linalg.solve(vectors, np.where", "np.multiply(vectors, np.where",
        "test_the_strain_rate_of_a_sheared_box_is_that_of_its_lattice",
    ),
    Mutation(
        "compiled/radial_distribution.py", "whose[low] > whose[high]", "whose[low] < whose[low]",
        "test_pairs_are_those_of_brute_force",
    ),
    Mutation(
        "compiled/radial_distribution.py", "away[across[1]], away[across[0]]", "away[across[0]], away[across[1]]",
        "test_pairs_are_those_of_brute_force",
    ),
    Mutation(
        "analysis/radial_distribution.py", "2 / 3 * both + along / 3", "2 / 3 * both + along / 2",
        "test_accessible_shells_are_those_of_quadrature",
    ),
    Mutation(
        "analysis/radial_distribution.py", "- np.diag(2.0**n * powers[n])", "",
        "test_the_ideal_gas_is_one_within_its_standard_error",
    ),
    Mutation(
        "analysis/contact_value.py", "(number + both)", "number",
        "test_the_error_of_independent_pairs_is_their_scatter",
    ),
    Mutation(
        "compiled/structure_factor.py", "re * sine[2, c, lane] + im", "re * sine[2, c, lane] - im",
        "test_waves_are_sums_of_exponentials",
    ),
    Mutation(
        "readers/files/table.py", "_MARGIN * end / share", "_MARGIN * end",
        "test_memory_for_equal_rows_is_set_aside_once",
    ),
    Mutation(
        "analysis/structure_factor.py", "half = plane if h else plane[len(plane) // 2 + 1 :]", "half = plane",
        "test_the_isotropic_one_is_the_mean_over_all_vectors",
    ),
    Mutation(
        "analysis/bond_order.py", "np.angle(means[0]) / n", "np.angle(means[0])",
        "test_the_angle_turns_with_the_neighbours",
    ),
    Mutation(
        "analysis/bond_order.py", "sums.sum(axis=1) / len(particle)", "sums.sum(axis=1) / count",
        "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "analysis/bond_order.py", "[bond, -bond]", "[bond, bond]",
        "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "analysis/bond_order.py", "nearest[0][:, 0] < distance[:, -1]", "nearest[0][:, 0] > distance[:, -1]",
        "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "analysis/bond_order.py", "len(position) + nearest[1][changed]", "nearest[1][changed]",
        "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "analysis/bond_order.py", "if distance.max() > reach * (1 + 1e-12):", "if False:",
        "test_wrong_input_is_named",
    ),
    Mutation(
        "analysis/bond_order.py", "is_itself[~is_itself.any(axis=1), -1] = True", "pass",
        "test_a_neighbour_at_the_same_place_is_an_error",
    ),
    Mutation(
        "analysis/bond_order.py", "scale *= 2", "scale *= 1", "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "analysis/bond_order.py", "-(n + m - 1) / (n - m)", "-(n - m - 1) / (n - m)",
        "test_harmonics_are_those_of_scipy",
    ),
    Mutation(
        "analysis/bond_order.py", "range(-1, -2 * m, -2)", "range(1, 2 * m, 2)",
        "test_harmonics_keep_their_digits_at_the_pole",
    ),
    Mutation(
        "analysis/bond_order.py", "reach = min(float(distance.max()), half)", "reach = 0.1 * half",
        "test_order_is_that_of_brute_force",
    ),
    Mutation(
        "compiled/voronoi.py", "0.5 * (d2 + radius2 - particles[j, 3] ** 2)", "0.5 * d2",
        "test_normals_point_from_the_first_particle_to_the_second",
    ),
    Mutation(
        "compiled/voronoi.py", "limit *= 8.0", "limit *= 1.0",
        "test_lattices_fill_the_box_however_little_they_are_disturbed",
    ),
    Mutation(
        "compiled/voronoi.py", "square = more", "square = 0.0",
        "test_normals_point_from_the_first_particle_to_the_second",
    ),
    Mutation(
        "compiled/voronoi.py", "0.5 * (y[t] * z[s] - z[t] * y[s])", "0.5 * (z[t] * y[s] - y[t] * z[s])",
        "test_faces_are_those_of_both_cells",
    ),
    Mutation(
        "compiled/voronoi.py", "2.0 * math.sqrt(farthest * gap2)", "math.sqrt(farthest * gap2)",
        "test_sizes_one_to_three_are_half_spaces_and_fill_the_box",
    ),
    Mutation(
        "compiled/voronoi.py", "if gap2 < square:", "if 2.0 * gap2 < square:",
        "test_sizes_one_to_three_are_half_spaces_and_fill_the_box",
    ),
    Mutation(
        "compiled/voronoi.py", "share = above[t] / (above[t] - min(above[stays], 0.0))", "share = 0.5",
        "test_sizes_one_to_three_are_half_spaces_and_fill_the_box",
    ),
    Mutation(
        "fields/advice.py", "is_small = noise <= CONSIDERABLE_FLOOR * shown",
        "is_small = noise > CONSIDERABLE_FLOOR * shown",
        "test_the_noise_of_inertial_numbers_is_that_of_the_fluctuations_of_the_step "
        "test_the_floor_of_a_shear_rate_is_relative_to_the_fluctuations",
    ),
    Mutation(
        "fields/advice.py", "is_small = shown < _CONTRADICTED * floor", "is_small = False",
        "test_flows_without_fluctuations_have_no_noise test_contacts_of_a_lattice_have_no_noise",
    ),
    Mutation(
        "fields/advice.py", "temperature = min(temperature, float(np.median(of_fits)))", "temperature = temperature",
        "test_a_converging_flow_without_fluctuations_has_no_noise test_flows_without_fluctuations_have_no_noise",
    ),
    Mutation(
        "fields/advice.py", "(parts.kinetic + parts.contact).sum()) * volume_fraction",
        "(parts.kinetic + parts.contact).sum())",
        "test_the_noise_of_inertial_numbers_is_that_of_the_fluctuations_of_the_step",
    ),
    Mutation(
        "fields/advice.py", "replace(support, contacts=_OF_LATTICE)", "support",
        "test_contacts_of_a_lattice_have_no_noise",
    ),
    Mutation(
        "fields/formulas/rows/contacts.py", "s.momentum - s.mass[..., None] * zero_if_unknown(",
        "s.momentum + s.mass[..., None] * zero_if_unknown(",
        "test_exchange_between_phases_equals_brute_force",
    ),
    Mutation(
        "readers/ends.py", "if after.rows < before.rows:", "if after.rows > before.rows:",
        "test_rows_are_no_ids_where_particles_are_removed",
    ),
    Mutation(
        "analysis/contact_history.py", "lattice.numbers(self.branch[new] - before.branch[old])",
        "lattice.numbers(0 * self.branch[new])", "test_another_image_is_another_contact",
    ),
    Mutation(
        "analysis/contact_history.py", "(now.first <= t - lag).sum()", "(now.first < t - lag).sum()",
        "test_ages_births_losses_and_lifetimes_of_one_contact",
    ),
    Mutation(
        "analysis/contact_history.py", "before.first[is_lost & (before.first > 0)]", "before.first[is_lost]",
        "test_contacts_of_the_first_step_have_no_lifetime",
    ),
    Mutation(
        "analysis/fit_law.py", "self.shared * covariance", "covariance",
        "test_nodes_closer_than_a_support_are_fewer_points",
    ),
    Mutation(
        "analysis/fit_law.py", "absolute_sigma=self.are_weighted", "absolute_sigma=False",
        "test_errors_of_parameters_are_in_proportion_to_those_of_the_points",
    ),
    Mutation(
        "analysis/fit_law.py", "(2 * change[k])", "change[k]",
        "test_the_band_of_a_line_is_that_of_its_formula",
    ),
    Mutation(
        "analysis/derive.py", "np.bincount(index, age, len(ids)) / count", "np.bincount(index, age, len(ids))",
        "test_mean_ages_grow_with_time_while_contacts_last",
    ),
    Mutation(
        "analysis/derive.py", "/ len(plane)", "/ 2",
        "test_stress_and_pressure_are_those_of_particle_stress",
    ),
    Mutation(
        "analysis/diffusion.py", "* velocity[indices[stay]]", "* velocity[: stay.sum()]",
        "test_velocity_autocorrelation_follows_grains_by_their_ids",
    ),
    Mutation(
        "analysis/compare.py", "of_before**2 + of_after**2", "of_after**2 - of_before**2",
        "test_the_difference_of_repeated_runs_scatters_by_its_error",
    ),
    Mutation(
        "analysis/compare.py", "of_before * after * scale", "of_before",
        "test_the_relative_error_is_that_of_the_ratio",
    ),
    Mutation(
        "analysis/fit_law.py", "(2 * dx)", "dx", "test_errors_of_x_count_by_the_slope_of_the_law",
    ),
    Mutation(
        "analysis/laws.py", "/ (h - first)) ** 1.5", "/ (h - first)) ** 0.5",
        "test_laws_have_the_properties_that_define_them",
    ),
    # --- chains ---
    Mutation(
        "analysis/force_chains.py", "np.bincount(now[1])[b] - common)", "np.bincount(now[1])[b])",
        "test_a_chain_survives_with_at_least_the_given_overlap",
    ),
    Mutation(
        "analysis/chain_selection.py", "np.asarray(self.velocity) * time", "np.asarray(self.velocity) / time",
        "test_moving_region_follows_time",
    ),
    Mutation(
        "analysis/force_chains.py", "least - _SHARE * abs(least)", "least + _SHARE * abs(least)",
        "test_threshold_and_least_length",
    ),
    Mutation(
        "analysis/particle_stress.py", "> ROUNDING * _norms(", "> -ROUNDING * _norms(",
        "test_rounding_of_pure_tension_makes_no_chains",
    ),
    Mutation(
        "analysis/particle_stress.py", "values[:, 0] - values[:, 1] <=", "values[:, 0] - values[:, 1] >",
        "test_grains_of_isotropic_stress_have_no_direction",
    ),
    # --- readers ---
    Mutation(
        "readers/engines/mercury.py", 'np.where(table["j"] < 0, -1.0, 1.0)', 'np.where(table["j"] < 0, 1.0, -1.0)',
        "test_contact_forces_are_read",
    ),
    Mutation(
        "readers/engines/lammps_binary.py", "walls[::2], walls[1::2]", "walls[:3], walls[:3]",
        "test_a_binary_dump_equals_the_text_dump_beside_it",
    ),
    Mutation(
        "readers/engines/lammps_netcdf.py", "v.length + -v.length % 4", "v.length",
        "test_records_of_odd_length_are_padded_unless_they_are_alone",
    ),
    Mutation(
        "readers/pairs.py", "most = 1e-3 * np.diff", "most = 1e-2 * np.diff",
        "test_times_pair_within_a_thousandth_of_the_shortest_interval",
    ),
    Mutation("readers/engines/yade.py", "(3, 3)).T", "(3, 3))", "test_a_sheared_cell_is_read"),
    Mutation(
        "readers/engines/mfix_contacts.py", "(force[kept] - force[gone]) / 2", "force[kept]",
        "test_mirrored_rows_become_one_with_the_mean_force",
    ),
    Mutation(
        "readers/paths.py", 'stamp["modified"] > _SETTLED', 'stamp["modified"] > -_SETTLED',
        "test_files_that_may_still_change_are_not_indexed",
    ),
    # --- writers ---
    Mutation(
        "writers/encoding.py", "share -= 2 * _SINGLE", "share -= 0.0",
        "test_rounding_errors_are_within_the_stated_bound test_single_precision_errors_are_within_the_note",
    ),
    Mutation(
        "writers/chains.py", 'before - root["NumberOfPoints"].shape[0] + 1', "before",
        "test_temporal_vtkhdf_equals_vtp",
    ),
    Mutation(
        "scene/conform.py", "if 0 in steps and any(steps)", "if 0 in steps and not any(steps)",
        "test_slices_of_lazy_series_equal_those_in_memory",
    ),
    Mutation(
        "scene/expressions.py", "if len(arguments) != function.nin", "if len(arguments) < function.nin",
        "test_an_argument_too_many_does_not_write_to_a_variable",
    ),
    Mutation(
        "scene/expressions.py", "return reduce(operator.and_, compared)", "return reduce(operator.or_, compared)",
        "test_expressions_equal_numpy",
    ),
    Mutation(
        "analysis/mixing.py", "if 0 < apart <= random", "if 0 < apart <= 0 * random",
        "test_few_large_grains_by_volume_have_no_index_and_a_warning",
    ),
    Mutation(
        "fields/advice.py", "is_in_memory(ids) and not (ids.to_numpy() != PADDING).any()", "False",
        "test_selections_of_nothing_are_named_with_the_range_of_positions",
    ),
    Mutation(
        "scene/gaps.py", "ids, numbers + shift", "ids, numbers - shift", "test_ids_off_by_one_are_named",
    ),
    Mutation(
        "scene/gaps.py", "gap = -pairs.overlap", "gap = pairs.overlap", "test_ids_off_by_one_are_named",
    ),
    Mutation(
        "scene/gaps.py", "_FEW = 10 ", "_FEW = 200 ", "test_few_gaps_are_no_verdict",
    ),
    Mutation(
        "scene/gaps.py", "_FEW = 10 ", "_FEW = 5 ", "test_few_gaps_are_no_verdict",
    ),
    Mutation(
        "scene/gaps.py", "_FEW_WIDE = 3", "_FEW_WIDE = 4", "test_few_gaps_are_no_verdict",
    ),
    Mutation(
        "scene/gaps.py", "len(distances) >= _FEW", "len(distances) > _FEW",
        "test_a_unit_is_blamed_for_ten_contacts_or_more",
    ),
    Mutation(
        "readers/caller_names.py", "(of_kind and (mapped or listed))", "(of_kind and mapped)",
        "test_names_of_another_form_show_each_form",
    ),
    Mutation(
        "scene/gaps.py", "_MOST = 0.01 ", "_MOST = 0.2 ", "test_few_gaps_are_no_verdict",
    ),
    Mutation(
        "scene/gaps.py", "pairs.overlap / pairs.touching\n    factor", "pairs.overlap / pairs.touching / 2\n    factor",
        "test_sizes_in_another_unit_than_positions_are_named",
    ),
    Mutation(
        "scene/normals.py", "unit_vectors(pairs.branch)", "-unit_vectors(pairs.branch)",
        "test_normals_of_zero_follow_from_positions",
    ),
    Mutation(
        "scene/sanity_masses.py", "abs(ratio / 8 - 1)", "abs(ratio / 4 - 1)",
        "test_volumes_that_are_not_those_of_the_axes_are_named",
    ),
    Mutation(
        "fields/grids/frames.py", "rotated.axes[:2] @", "rotated.axes[1:] @",
        "test_an_axis_far_from_the_particles_is_named",
    ),
    Mutation(
        "readers/files/blocks.py", "unit[0] if convert else 1.0", "1.0 / unit[0] if convert else 1.0",
        "test_times_in_a_text_have_units",
    ),
    Mutation(
        "readers/files/blocks.py", "below = k + 1 + bool(", "below = k + bool(",
        "test_texts_of_any_suffix_are_recognised_below_lines_with_the_time",
    ),
    Mutation(
        "readers/files/blocks.py", "            time = None\n", "            pass\n",
        "test_tables_without_a_time_between_them_are_an_error",
    ),
    Mutation(
        "scene/normals.py", "np.abs(cosine) < _ANGLE", "cosine < _ANGLE", "test_opposite_normals_are_turned",
    ),
    Mutation(
        "scene/normals.py", "scaled[wrong] /= length", "scaled[wrong] *= length",
        "test_normals_of_another_length_are_scaled",
    ),
    Mutation(
        "scene/spheres.py", "_UNITS = (1e3, 1e-3)", "_UNITS = (1e2, 1e-2)",
        "test_points_in_another_unit_are_named_with_it",
    ),
    Mutation(
        "scene/sanity_lengths.py", "length = high - low\n        far", "length = high\n        far",
        "test_a_box_in_another_unit_warns test_grains_outside_the_box_warn",
    ),
    Mutation(
        "writers/formats.py", "at = min(len(view), self._end - offset)", "at = 0",
        "test_a_file_comes_to_the_state_after_the_last_task",
    ),
    # --- jobs ---
    Mutation(
        "jobs/pysammos_config.py", "(number - (start or 0)) % stride", "number % stride",
        "test_steps_of_a_configuration_count_from_the_first",
    ),
    Mutation(
        "jobs/run.py", "all(_made_by(path) == mark", "any(_made_by(path) != mark",
        "test_resume_never_starts_over",
    ),
    Mutation(
        "jobs/toml_config.py", 'output.get("netcdf", True)', 'output.get("netcdf", False)',
        "test_what_a_job_leaves_out_has_the_documented_default",
    ),
]  # fmt: skip


def files_of(names: list[str]) -> list[str]:
    """Return the ids of tests with these names, wherever they are; raise LookupError for unknown ones."""
    ids: dict[str, list[str]] = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for name in re.findall(r"^def (\w+)\(", path.read_text(), re.MULTILINE):
            ids.setdefault(name, []).append(f"{path.relative_to(ROOT)}::{name}")
    if unknown := [name for name in names if name not in ids]:
        raise LookupError(f"there is no test of the name {unknown[0]}: was it renamed?")
    return [test for name in dict.fromkeys(names) for test in ids[name]]


def run_tests(folder: Path, ids: list[str], cache: Path) -> tuple[int, str]:
    """Run tests on the package in a folder until one fails; return pytest's exit code, and that test or the output."""
    # a mutation of the same length within a second would leave the time and size that Python's own cache goes by
    env = os.environ | {
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": str(folder),
        "NUMBA_CACHE_DIR": str(cache),
    }
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-m",
        "",
        "-p",
        "no:cacheprovider",
        "--tb=line",
        "-rf",
        *ids,
    ]
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=env,
            capture_output=True,
            text=True,
            timeout=LONGEST,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return 1, "does not end"
    if failed := re.findall(r"^FAILED \S+?::(.+?)(?: - |$)", done.stdout, re.MULTILINE):
        return 1, failed[0]
    if done.returncode < 0:  # indices beyond arrays, which loops do not check
        return 1, "a crash of the interpreter"
    return done.returncode, done.stdout[-2000:] + done.stderr[-500:]


def mutated(folder: Path, mutation: Mutation, ids: list[str], cache: Path) -> str:
    """Apply a mutation, run tests and undo it; return the test that failed, "" if none did."""
    path = folder / "xcg" / mutation.file
    text = path.read_text()
    stat = path.stat()
    path.write_text(text.replace(mutation.old, mutation.new))
    own = cache if "compiled" not in mutation.file else Path(tempfile.mkdtemp(dir=folder))
    try:
        code, said = run_tests(folder, ids, own)
    finally:
        path.write_text(text)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        if own != cache:
            shutil.rmtree(own)
    if code not in (0, 1):
        raise RuntimeError(
            f"{mutation.file}: {mutation.new!r} is no mutation, pytest ended with {code}:\n{said}"
        )
    return said if code else ""


def main() -> int:
    """Run the rows of the table; return how pytest would end."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", metavar="WORD", default="", help="rows with this word in the file or the text"
    )
    only = parser.parse_args().only
    rows = [row for row in TABLE if only in " ".join(row)]
    if not rows:
        parser.error(f"no row has the word {only!r}")
    for row in rows:
        count = (ROOT / "xcg" / row.file).read_text().count(row.old)
        if count != 1:
            raise LookupError(
                f"xcg/{row.file} holds {row.old!r} {count} times, expected once: update the table"
            )
    ids = [files_of(row.tests.split()) for row in rows]
    survivors = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "copy"
        cache = Path(name) / "cache"
        folder.mkdir()
        cache.mkdir()
        for part in COPIED:
            if (ROOT / part).is_dir():
                shutil.copytree(
                    ROOT / part,
                    folder / part,
                    ignore=shutil.ignore_patterns("__pycache__", "_build"),
                )
            else:
                shutil.copy2(ROOT / part, folder)
        code, said = run_tests(folder, sorted({one for some in ids for one in some}), cache)
        if code:
            raise RuntimeError(f"tests fail on the unchanged package: {said}")
        for row, some in zip(rows, ids, strict=True):
            start = time.monotonic()
            caught = mutated(folder, row, some, cache)
            survivors += not caught
            end = f"caught by {caught}" if caught else "SURVIVED"
            print(
                f"{end}: {row.file}: {row.old!r} -> {row.new!r} ({time.monotonic() - start:.0f} s)",
                flush=True,
            )
    print(f"{len(rows) - survivors} of {len(rows)} mutations are caught")
    return int(survivors > 0)


if __name__ == "__main__":
    raise SystemExit(main())
