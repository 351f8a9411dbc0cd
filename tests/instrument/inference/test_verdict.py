"""Verdicts, and what forbids to settle one."""

from __future__ import annotations

import dataclasses

import pytest

from loose_env.instrument.inference.findings.verdict import verdict_of
from loose_env.instrument.inference.posterior import (
    ModelComparison,
    compare_hypotheses,
    posterior_of,
)
from loose_env.instrument.inference.response.timing import ClockOffset
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.instrument.settings.thresholds import MISMATCH
from tests.instrument.arms.blind_arm import runs, write_model

SURE = 0.98


@pytest.fixture(scope="module")
def slide(tmp_path_factory: pytest.TempPathFactory) -> ModelComparison:
    bench = Workbench(
        write_model(tmp_path_factory.mktemp("arm")), DiagnoseSettings(poses=2, seconds=1.0)
    )
    for run in runs("slide", 3):
        bench.add(run)
    return compare_hypotheses(bench.uncertain, bench.suspect, healthy_prior=0.5)


def with_terms(comparison: ModelComparison, **changes: float) -> ModelComparison:
    """The comparison with fields of every run's term changed."""
    fits = {
        name: dataclasses.replace(
            fit, runs={k: dataclasses.replace(term, **changes) for k, term in fit.runs.items()}
        )
        for name, fit in comparison.fits.items()
    }
    return dataclasses.replace(comparison, fits=fits)


def test_a_clear_fault_is_settled(slide: ModelComparison) -> None:
    assert verdict_of(slide, (), sure=SURE).kind == "faulty"


def test_a_misfit_blocks_the_verdict_and_names_the_model(slide: ModelComparison) -> None:
    found = verdict_of(with_terms(slide, misfit=2 * MISMATCH), (), sure=SURE)
    assert found.kind == "model_mismatch"
    assert f"leaves {2 * MISMATCH:.0%}" in found.reasons[0]


def test_a_clock_offset_blocks_the_verdict(slide: ModelComparison) -> None:
    clock = ClockOffset(seconds=5e-3, sd=1e-5)
    found = verdict_of(slide, (clock,), sure=SURE)
    assert found.kind == "open" and "5.0 ms late" in found.reasons[0]
    unknown = ClockOffset(seconds=5e-3, sd=5e-3)
    assert verdict_of(slide, (unknown,), sure=SURE).kind == "faulty"


def test_a_posterior_that_rests_on_one_run_is_open(slide: ModelComparison) -> None:
    """All other runs favour a healthy arm by a little less than one speaks against it."""
    healthy = slide.fits["healthy"]
    lead = 5.0
    runs = {
        number: dataclasses.replace(
            healthy.runs[number],
            log_likelihood=term.log_likelihood + (-60.0 if number == 0 else lead),
        )
        for number, term in slide.fits[slide.best].runs.items()
    }
    cost = slide.fits[slide.best].evidence - sum(
        term.log_likelihood for term in slide.fits[slide.best].runs.values()
    )
    evidence = cost + sum(term.log_likelihood for term in runs.values())
    fits = {
        "healthy": dataclasses.replace(healthy, runs=runs, evidence=evidence),
        slide.best: slide.fits[slide.best],
    }
    posterior = posterior_of(fits, slide.lines, healthy_prior=0.5)
    found = verdict_of(dataclasses.replace(slide, fits=fits, posterior=posterior), (), sure=0.5)
    assert posterior[slide.best] > 0.5
    assert found.kind == "open" and "rests on one run" in found.reasons[-1]


@pytest.mark.parametrize(("held", "said"), [(0.05, "healthy"), (0.9, "open")])
def test_an_arm_is_healthy_only_where_a_fault_would_have_opened(
    slide: ModelComparison, held: float, said: str
) -> None:
    """Runs too weak to open any seat show nothing, and nothing is what they find."""
    weak = with_terms(slide, shut=0.99, held=held, misfit=0.01)
    posterior = {name: 0.999 if name == "healthy" else 1e-4 for name in slide.posterior}
    fits = {**weak.fits, "healthy": with_terms(weak, shut=1.0, held=1.0).fits["healthy"]}
    found = verdict_of(dataclasses.replace(weak, posterior=posterior, fits=fits), (), sure=SURE)
    assert found.kind == said
    assert ("would have opened" in " ".join(found.reasons)) == (said == "open")
