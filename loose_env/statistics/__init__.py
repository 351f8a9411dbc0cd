"""Statistics of one record: pure functions of arrays.

Data flow: _checks -> directions -> gaussian_mixture -> moments -> correlation ->
spectra -> transmission.
"""

from loose_env.statistics._checks import (
    as_finite_samples,
    as_floats,
    as_record,
    require_finite,
    require_rate,
)
from loose_env.statistics.correlation import (
    ComparativeIndex,
    LowestCoherence,
    MaximumCorrelation,
    comparative_index,
    correlation_loop,
    correlation_loop_from,
    lowest_coherence_direction_from,
    lowest_correlation_direction,
    maximum_correlation,
)
from loose_env.statistics.directions import (
    axes_grid,
    axial_angle,
    axial_difference,
    axial_mean,
    axial_vector,
    tangents,
    wrap_axial,
)
from loose_env.statistics.gaussian_mixture import (
    GaussianMixture,
    fit_gaussian_mixture,
)
from loose_env.statistics.moments import (
    Covariances,
    RecordCovariances,
    covariances,
    kurtosis,
    record_covariances,
    shape_of,
    skewness,
)
from loose_env.statistics.spectra import (
    PhaseDelay,
    TransferFunction,
    acceleration_from_angle,
    bandpass,
    channel_floor,
    long_run_variance,
    noise_floor,
    phase_delay,
    resolution_of,
    transfer_function,
)
from loose_env.statistics.transmission import (
    apparent_inertia_from,
    transmission,
    transmission_by_instrument_from,
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
    "acceleration_from_angle",
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
    "channel_floor",
    "comparative_index",
    "correlation_loop",
    "correlation_loop_from",
    "covariances",
    "fit_gaussian_mixture",
    "kurtosis",
    "long_run_variance",
    "lowest_coherence_direction_from",
    "lowest_correlation_direction",
    "maximum_correlation",
    "noise_floor",
    "phase_delay",
    "record_covariances",
    "require_finite",
    "require_rate",
    "resolution_of",
    "shape_of",
    "skewness",
    "tangents",
    "transfer_function",
    "transmission",
    "transmission_by_instrument_from",
    "transmission_from",
    "wrap_axial",
]
