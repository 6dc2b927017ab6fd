"""Plans as they travel to other processes."""

import pickle

import xcg


def test_plans_leave_their_definitions_behind_and_look_them_up_again():
    """Formulas are functions without names, which plain pickle refuses."""
    plan = xcg.datasets.random_scene(50).cg.explain(["velocity", "stress"], axes="z")
    again = pickle.loads(pickle.dumps(plan))
    assert "rows" not in vars(again)
    assert list(again.definitions) == list(plan.fields)
    assert all(again.definitions[name] is plan.definitions[name] for name in plan.fields)
    assert again.shapes == plan.shapes


def test_shapes_of_a_plan_are_those_of_its_result():
    ds = xcg.datasets.random_scene(80)
    options = {"by": "species", "by_pair": True, "axes": "xz", "spacing": 1.5, "width": 1.0}
    fields = ["density", "velocity", "contact_stress"]
    plan = ds.cg.explain(fields, **options)
    f = ds.cg.coarse_grain(fields, **options)
    for name in plan.fields:
        assert f[name].shape == (f.sizes["time"], *plan.shapes[name])
        assert f[name].dims == ("time", *plan.outputs[name].dims)
