"""Statistics of one record: pure functions of arrays.

Data flow: _checks -> directions -> gaussian_mixture -> records -> correlation -> sampling ->
tool_transmission.
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
    lowest_coherence_direction,
    lowest_coherence_direction_from,
)
from loose_env.statistics.correlation.comparative_index import (
    ComparativeIndex,
    comparative_index,
)
from loose_env.statistics.correlation.delay import (
    PhaseDelay,
    phase_delay,
)
from loose_env.statistics.directions.angles import (
    axial_angle,
    axial_difference,
    axial_mean,
    axial_vector,
    wrap_axial,
)
from loose_env.statistics.directions.sphere import (
    axes_grid,
    tangents,
)
from loose_env.statistics.gaussian_mixture import (
    GaussianMixture,
    fit_gaussian_mixture,
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

__all__ = [
    "ComparativeIndex",
    "Covariances",
    "GaussianMixture",
    "LowestCoherence",
    "MaximumCorrelation",
    "PhaseDelay",
    "RecordCovariances",
    "TransferFunction",
    "TransmissionChange",
    "acceleration_from_angle",
    "apparent_inertia",
    "apparent_inertia_from",
    "as_finite_samples",
    "as_floats",
    "as_record",
    "axes_grid",
    "axial_angle",
    "axial_difference",
    "axial_mean",
    "axial_vector",
    "bandpass",
    "comparative_index",
    "correlation_loop",
    "correlation_loop_from",
    "covariances",
    "fit_gaussian_mixture",
    "kurtosis",
    "lowest_coherence_direction",
    "lowest_coherence_direction_from",
    "lowest_correlation_direction",
    "lowest_correlation_direction_from",
    "maximum_correlation",
    "maximum_correlation_from",
    "memory_of",
    "phase_delay",
    "record_covariances",
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
    "wrap_axial",
]
