"""Benchmarks: pytest tests/benchmarks --benchmark-only, with XCG_BENCHMARK_LARGE=1 for a million grains as well."""

import os

import pytest

from tests.benchmarks import cases

PARTICLES = int(os.environ.get("XCG_BENCHMARK_PARTICLES", "100000"))
LARGE = pytest.mark.skipif(
    "XCG_BENCHMARK_LARGE" not in os.environ, reason="set XCG_BENCHMARK_LARGE=1"
)


def label(case):
    return f"{case.name}, {case.threads} thread{'s' * (case.threads > 1)}{case.over}"


def run(benchmark, case, particles):
    ds = case.scene(particles)
    benchmark.pedantic(case.run, (ds,), rounds=3, warmup_rounds=1)
    share = ds.sizes["particle"] * ds.sizes["time"]
    benchmark.extra_info["us_per_particle_and_step"] = round(
        1e6 * benchmark.stats.stats.min / share, 3
    )


@pytest.mark.parametrize("case", cases.CASES, ids=label)
def test_speed(benchmark, case):
    run(benchmark, case, PARTICLES)


@LARGE
@pytest.mark.parametrize("case", cases.LARGE, ids=label)
def test_speed_of_a_million(benchmark, case):
    run(benchmark, case, 1_000_000)


def test_first_result_in_a_fresh_process(benchmark):
    cold, warm = benchmark.pedantic(cases.first_result, rounds=1)
    benchmark.extra_info.update(cold=round(cold, 2), warm=round(warm, 2))


@pytest.mark.parametrize("case", cases.CASES[:7], ids=label)
def test_peak_memory(benchmark, case):
    case.run(
        case.scene(200)
    )  # compiled code is on disk, so that the compiler's memory does not count
    peak = benchmark.pedantic(cases.peak_memory, (case, PARTICLES), rounds=1)
    benchmark.extra_info["peak_MB"] = round(peak)


@pytest.mark.parametrize("case", cases.CASES, ids=label)
def test_cases_run(case):
    """Not a benchmark: keeps them from rotting."""
    case.run(case.scene(400))
