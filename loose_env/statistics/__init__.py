"""Statistics of one record: pure functions of arrays.

Data flow: _checks -> directions -> gaussian_mixture -> records -> correlation -> sampling ->
tool_transmission -> intervals.
"""

from loose_env.statistics._checks import (
    as_finite_samples,
    as_floats,
    as_record,
    require_finite,
    require_rate,
)
from loose_env.statistics.correlation.by_direction import (
    MaximumCorrelation,
    correlation_loop,
    correlation_loop_from,
    lowest_correlation_direction,
    lowest_correlation_direction_from,
    maximum_correlation,
    maximum_correlation_from,
)
from loose_env.statistics.correlation.coherence import (
    LowestCoherence,
    RankTest,
    lowest_coherence_direction,
    lowest_coherence_direction_from,
    rank_test,
    rank_test_from,
)
from loose_env.statistics.correlation.comparative_index import (
    ComparativeIndex,
    comparative_index,
)
from loose_env.statistics.correlation.delay import (
    PhaseDelay,
    phase_delay,
)
from loose_env.statistics.correlation.zero_correlation import (
    lowest_coherence_of_records,
    uncorrelated_axis,
    uncorrelated_plane,
)
from loose_env.statistics.directions.angles import (
    axial_angle,
    axial_difference,
    axial_mean,
    axial_vector,
    wrap_axial,
)
from loose_env.statistics.directions.sphere import (
    HemisphereSearch,
    axes_grid,
    axial_angle_between,
    hemisphere_search,
    tangents,
)
from loose_env.statistics.gaussian_mixture import (
    GaussianMixture,
    fit_gaussian_mixture,
)
from loose_env.statistics.intervals.axis import (
    DirectionInterval,
)
from loose_env.statistics.intervals.direction import (
    change_direction_interval,
    direction_interval,
)
from loose_env.statistics.intervals.record_length import (
    direction_sd,
    record_length_for,
)
from loose_env.statistics.records.covariance import (
    Covariances,
    RecordCovariances,
    covariances,
    record_covariances,
)
from loose_env.statistics.records.moments import (
    kurtosis,
    shape_of,
    skewness,
)
from loose_env.statistics.records.spectra import (
    TransferFunction,
    acceleration_from_angle,
    bandpass,
    transfer_function,
)
from loose_env.statistics.sampling.autocorrelation import (
    memory_of,
)
from loose_env.statistics.sampling.effective_samples import (
    effective_samples,
)
from loose_env.statistics.tool_transmission.change import (
    TransmissionChange,
    apparent_inertia,
    apparent_inertia_from,
    transmission,
    transmission_by_instrument,
    transmission_by_instrument_from,
    transmission_change,
    transmission_from,
)
from loose_env.statistics.tool_transmission.direction import (
    ChangeDirection,
    change_direction,
)
from loose_env.statistics.tool_transmission.estimate import (
    TransmissionEstimate,
    estimate_transmission,
    join_transmissions,
    pool_transmissions,
)
from loose_env.statistics.tool_transmission.rank import (
    ChangeRank,
    change_rank,
)

__all__ = [
    "ChangeDirection",
    "ChangeRank",
    "ComparativeIndex",
    "Covariances",
    "DirectionInterval",
    "GaussianMixture",
    "HemisphereSearch",
    "LowestCoherence",
    "MaximumCorrelation",
    "PhaseDelay",
    "RankTest",
    "RecordCovariances",
    "TransferFunction",
    "TransmissionChange",
    "TransmissionEstimate",
    "acceleration_from_angle",
    "apparent_inertia",
    "apparent_inertia_from",
    "as_finite_samples",
    "as_floats",
    "as_record",
    "axes_grid",
    "axial_angle",
    "axial_angle_between",
    "axial_difference",
    "axial_mean",
    "axial_vector",
    "bandpass",
    "change_direction",
    "change_direction_interval",
    "change_rank",
    "comparative_index",
    "correlation_loop",
    "correlation_loop_from",
    "covariances",
    "direction_interval",
    "direction_sd",
    "effective_samples",
    "estimate_transmission",
    "fit_gaussian_mixture",
    "hemisphere_search",
    "join_transmissions",
    "kurtosis",
    "lowest_coherence_direction",
    "lowest_coherence_direction_from",
    "lowest_coherence_of_records",
    "lowest_correlation_direction",
    "lowest_correlation_direction_from",
    "maximum_correlation",
    "maximum_correlation_from",
    "memory_of",
    "phase_delay",
    "pool_transmissions",
    "rank_test",
    "rank_test_from",
    "record_covariances",
    "record_length_for",
    "require_finite",
    "require_rate",
    "shape_of",
    "skewness",
    "tangents",
    "transfer_function",
    "transmission",
    "transmission_by_instrument",
    "transmission_by_instrument_from",
    "transmission_change",
    "transmission_from",
    "uncorrelated_axis",
    "uncorrelated_plane",
    "wrap_axial",
]
