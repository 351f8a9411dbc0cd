"""Control charts: their false-alarm rate is the stated one, and changes are found."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.instrument.trend.cusum import control_chart, limits_for


@pytest.mark.parametrize("two_sided", [True, False])
@pytest.mark.parametrize("rate", [0.05, 0.02])
def test_healthy_series_alarm_at_most_at_the_stated_rate(rate: float, two_sided: bool) -> None:
    limits = limits_for(rate, allowance=0.5, two_sided=two_sided)
    rng = np.random.default_rng(5)
    alarms = sessions = 0
    for _ in range(400):
        chart = control_chart(rng.normal(3.0, 0.2, 40), limits, least_scatter=1e-9)
        end = 39 if chart.alarm is None else chart.alarm
        alarms += chart.alarm is not None
        sessions += end - 1  # two make the baseline
    deviation = np.sqrt(rate / sessions)
    assert 0.4 * rate < alarms / sessions < rate + 2 * deviation


def test_a_drift_is_found_by_the_sum_before_any_single_value_stands_out() -> None:
    rng = np.random.default_rng(7)
    drift = np.concatenate([np.zeros(15), np.full(15, 1.6)])
    limits = limits_for(0.01, allowance=0.5, two_sided=True)
    chart = control_chart(rng.normal(size=30) + drift, limits, least_scatter=1e-9)
    assert chart.alarm is not None and 15 <= chart.alarm <= 22


def test_a_decrease_alarms_only_where_both_sides_count() -> None:
    values = np.array([0.0, 0.1, -0.1, 0.05, 0.0, -0.05, -5.0])
    for two_sided, alarm in ((True, 6), (False, None)):
        limits = limits_for(0.01, allowance=0.5, two_sided=two_sided)
        assert control_chart(values, limits, least_scatter=0.01).alarm == alarm


def test_a_restart_forgets_alarm_and_baseline_and_missing_sessions_do_not_count() -> None:
    limits = limits_for(0.01, allowance=0.5, two_sided=True)
    values = np.array([0.0, 0.1, np.nan, -0.1, 0.05, 6.0, 6.1, 0.0, 0.1, -0.05, 0.0])
    chart = control_chart(values, limits, least_scatter=0.01, restarts=(7,))
    assert chart.alarms == (5,) and chart.alarm is None
    assert np.isnan(chart.statistic[[0, 1, 2, 7, 8]]).all()
    assert np.isfinite(chart.statistic[[3, 4, 9, 10]]).all()


@pytest.mark.parametrize(("rate", "allowance"), [(0.0, 0.5), (0.7, 0.5), (0.01, 0.0)])
def test_rates_and_allowances_that_make_no_sense_are_refused(rate: float, allowance: float) -> None:
    with pytest.raises(InvalidSetting):
        limits_for(rate, allowance=allowance, two_sided=True)
